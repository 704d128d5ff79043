"""What the fake arm does right now, in shared memory: written by the fake controller each cycle, read by any process."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from multiprocessing import shared_memory
from types import TracebackType
from typing import Self

import numpy as np
from mbcacq_kuka.shared_block import SharedBlock, allocated, attached

from mbcacq.errors import SystemRefused

FAULTS = (
    "",
    "controller stopped by its operator",
    "late packets: RSI stopped",
    "overspeed: command velocity",
    "permissible overall correction exceeded",
    "software limit switch",
    "command acceleration exceeded",
)

MOST_AXES = 9  # that fit into a slot

_COUNT = struct.Struct("<q")
_AXES_AT = 8  # number of axes, behind the count
_SLOT_AT = (64, 64 + 256)  # two slots on cache lines of their own; the one not being written is always whole
_OUTPUTS_AT = 64 + 2 * 256  # a row an output that was ever switched: its number + 1, its value, how often it was switched on
_OUTPUT = struct.Struct("<3q")
_MOST_OUTPUTS = 16
_HISTORY_AT = _OUTPUTS_AT + _MOST_OUTPUTS * _OUTPUT.size + 64  # a ring of the states before, for sensors that measure in motion
_KEPT = 4096
_SIZE = _HISTORY_AT + _KEPT * 8 * (4 + 3 * MOST_AXES)

_NO_MEMORY = "the fake controller has no {} KiB of shared memory ({}); free some in /dev/shm, which must be writable"


@dataclass(frozen=True)
class ArmReading:
    """One consistent state. q (n,) rad as the controller reports it, qd (n,) rad/s, direction (n,) -1, 0 or 1: direction of
    each axis' last motion.

    arrivals counts the motions that the arm has begun, each of which ends in an arrival; fault is '' or why the controller stopped.
    """

    time_s: float
    q: tuple[float, ...]
    qd: tuple[float, ...]
    direction: tuple[float, ...]
    standstill: bool
    arrivals: int
    fault: str


class ArmState(SharedBlock):
    """A named block of shared memory. One process creates it (and unlinks it on close), any number attach by ``name``.

    axes: how many the arm has; 0 where that is read from the block.
    """

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool, axes: int = 0) -> None:
        super().__init__(memory, owner)
        self._count, self.axes = 0, axes or _COUNT.unpack_from(self._buffer, _AXES_AT)[0]
        _COUNT.pack_into(self._buffer, _AXES_AT, self.axes)
        self._slot = struct.Struct(f"<{4 + 3 * self.axes}d")

    @classmethod
    def create(cls, q: tuple[float, ...] = (0.0,) * 6, name: str | None = None) -> ArmState:
        """A new block holding an arm at rest at ``q`` (n,) rad, n up to MOST_AXES. Raises SystemRefused if there is no memory for it."""
        state = cls(create_shared_memory(_SIZE, name), True, len(q))
        state.write(0.0, q, (0.0,) * len(q), (0.0,) * len(q), True, 0)
        return state

    @classmethod
    def attach(cls, name: str) -> ArmState:
        """Raises FileNotFoundError if there is no such block (yet)."""
        state = cls(attached(name), False)
        state._count = _COUNT.unpack_from(state._buffer, 0)[0]
        return state

    def write(
        self,
        time_s: float,
        q: tuple[float, ...],
        qd: tuple[float, ...],
        direction: tuple[float, ...],
        standstill: bool,
        arrivals: int,
        fault: int = 0,
    ) -> None:
        """Publish a state (one writer only). ``fault`` indexes FAULTS."""
        count = self._count + 1
        values = (time_s, *q, *qd, *direction, standstill, arrivals, fault)
        self._slot.pack_into(self._buffer, _SLOT_AT[count & 1], *values)
        self._slot.pack_into(self._buffer, _HISTORY_AT + count % _KEPT * self._slot.size, *values)
        _COUNT.pack_into(self._buffer, 0, count)
        self._count = count

    def read(self) -> ArmReading:
        """The latest state, never a mixture of two."""
        buffer = self._buffer
        while True:
            (count,) = _COUNT.unpack_from(buffer, 0)
            v = self._slot.unpack_from(buffer, _SLOT_AT[count & 1])
            if _COUNT.unpack_from(buffer, 0)[0] == count:
                n = self.axes
                q, qd, direction = v[1 : 1 + n], v[1 + n : 1 + 2 * n], v[1 + 2 * n : 1 + 3 * n]
                return ArmReading(v[0], q, qd, direction, v[-3] != 0.0, int(v[-2]), FAULTS[int(v[-1])])

    def history(self) -> np.ndarray:
        """(k, 4 + 3 n): the states before, oldest first, a row as ``ArmReading`` has it: time_s, q, qd, direction, standstill, arrivals,
        fault. Half a ring of them, which the writer leaves alone meanwhile."""
        (count,) = _COUNT.unpack_from(self._buffer, 0)
        ring = np.ndarray((_KEPT, self._slot.size // 8), np.float64, self._buffer, _HISTORY_AT)
        return ring[np.arange(max(count - _KEPT // 2, 1), count + 1) % _KEPT]

    def switch(self, number: int, value: bool) -> None:
        """The controller's digital output ``number`` changes to ``value`` (one writer only)."""
        at = self._output_at(number)
        _, _, rises = _OUTPUT.unpack_from(self._buffer, at)
        _OUTPUT.pack_into(self._buffer, at, number + 1, value, rises + value)

    def output(self, number: int) -> tuple[bool, int]:
        """Whether the output is on, and how often it was switched on so far."""
        _, value, rises = _OUTPUT.unpack_from(self._buffer, self._output_at(number))
        return bool(value), rises

    def _output_at(self, number: int) -> int:
        """Where its row is, or the first free one."""
        for at in range(_OUTPUTS_AT, _SIZE, _OUTPUT.size):
            if _OUTPUT.unpack_from(self._buffer, at)[0] in (0, number + 1):
                return at
        raise ValueError(f"no more than {_MOST_OUTPUTS} outputs can be switched")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def create_shared_memory(size: int, name: str | None = None) -> shared_memory.SharedMemory:
    """A new block whose memory is there. Raises SystemRefused if it is not."""
    try:
        return allocated(size, name)
    except FileExistsError:
        raise
    except OSError as error:
        raise SystemRefused(_NO_MEMORY.format(-(-size // 1024), error.strerror)) from error
