"""A data set: the messages of one frame, up to the one that is marked as the last."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.devices import ProtocolError
from mbcacq_gocator import layouts
from mbcacq_gocator.decode import ArrayMessage, Measurement, Stamp, Unknown, decode
from mbcacq_gocator.wire import MessageReader

_MAX_MESSAGES = 10_000


@dataclass
class DataSet:
    """Arrays are views into the reader's buffer, valid until the next set is read."""

    stamp: Stamp | None = None
    arrays: list[ArrayMessage] = field(default_factory=list)
    measurements: dict[str, float] = field(default_factory=dict)
    skipped: set[int] = field(default_factory=set)

    @property
    def stamps(self) -> np.ndarray | None:
        """(k, 5) as ``Stamp.every``."""
        return None if self.stamp is None else self.stamp.every

    @property
    def contents(self) -> str:
        """What came besides the stamp, for messages to people."""
        names = [layouts.TYPE_NAMES.get(kind, f"type {kind}") for kind in sorted({a.type for a in self.arrays} | self.skipped)]
        return ", ".join(names + (["measurements"] if self.measurements else []))


def read_set(reader: MessageReader, deadline: float) -> DataSet:
    """The next whole set. Raises DeviceTimeout, Dropped (a ConnectError), ProtocolError, Aborted."""
    reader.rewind()
    result = DataSet()
    for _ in range(_MAX_MESSAGES):
        message, last = decode(reader.read(deadline))
        if isinstance(message, Stamp):
            if result.stamp is not None and result.stamp.frame != message.frame:
                result = DataSet()  # the end of the frame before was lost: its arrays are not this frame's
            result.stamp = message
        elif isinstance(message, ArrayMessage):
            result.arrays.append(message)
        elif isinstance(message, Measurement):
            _add(result.measurements, message)
        elif isinstance(message, Unknown):
            result.skipped.add(message.type)
        if last:
            return result
    raise ProtocolError(f"the Gocator sent {_MAX_MESSAGES} messages without ending its data set")


def _add(measurements: dict[str, float], message: Measurement) -> None:
    if len(measurements) + len(message.value) > layouts.MAX_VALUES:
        raise ProtocolError(f"the Gocator sent more than {layouts.MAX_VALUES} measurements in one data set")
    for index, value in enumerate(message.value.tolist()):
        measurements[f"measurement_{message.id}" + (f".{index}" if index else "")] = value
