"""The stream of a line scanner's profiles: a thread takes data sets off the wire, and whole blocks of them become points.

A data set has one stamp and one profile, or several of both where the sensor sends them together.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

import numpy as np

from mbcacq.devices import DeviceFault, DeviceTimeout, MbcacqError, Profiles, ProtocolError
from mbcacq_gocator.dataset import DataSet
from mbcacq_gocator.decode import TICKS_PER_US, ArrayMessage
from mbcacq_gocator.layouts import INVALID, PROFILE_POINTS, TYPE_NAMES, UNIFORM_PROFILE

_POLL_S = 0.05
_QUIET = 8  # polls without a data set, after which a stopped sensor has sent all; a busy computer polls more slowly


@dataclass(frozen=True)
class ProfileBlock:
    """Profiles of one data set. counter, time_s, encoder, inputs: (k,), as ``Profiles``. raw: (k, W) z or (k, W, 2) x and z, int16; scale,
    offset: (2,) mm, of x and z."""

    counter: np.ndarray
    time_s: np.ndarray
    encoder: np.ndarray
    inputs: np.ndarray
    raw: np.ndarray
    scale: tuple[float, float]
    offset: tuple[float, float]


class ProfileSource(Protocol):
    """A connected sensor that sends profiles from ``start`` to ``stop``."""

    @property
    def data_socket(self) -> socket.socket | None:
        """The connection of the data channel, to wait at; None once it is closed."""
        ...

    @property
    def is_wanted(self) -> bool:
        """Whether nobody has stopped what waits for the sensor."""
        ...

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def next_profiles(self, deadline: float) -> ProfileBlock | None:
        """The profiles of the next data set, copied; None if it has none, or the session is closed.

        Raises DeviceTimeout, ConnectError, ProtocolError, Aborted."""
        ...


class ProfileStream:
    """Starts the sensor, and its own thread. timeout_s: of one data set. after_s: time of the last profile of an earlier stream, -inf
    without one."""

    def __init__(self, session: ProfileSource, timeout_s: float, after_s: float = -np.inf) -> None:
        self._session, self._timeout_s = session, timeout_s
        self._blocks: list[ProfileBlock] = []
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._error: MbcacqError | None = None
        self._frame: int | None = None  # of the last profile that was returned
        self.latest_s = after_s  # its time
        self._thread = threading.Thread(target=self._read, name="gocator-profiles", daemon=True)
        session.start()
        self._thread.start()

    def end(self) -> None:
        """Stop the sensor and wait for what is under way. Raises as ``stop`` of the session, and what ended the stream before."""
        try:
            if self._thread.is_alive():
                self._session.stop()
        finally:
            self._ending.set()
            self._thread.join(self._timeout_s)
        if self._error is not None:
            raise self._error
        if self._thread.is_alive():
            raise DeviceTimeout(f"profiles still come {self._timeout_s:g} s after the sensor was stopped; see that nothing else starts it")

    def taken(self) -> Profiles:
        """All since the last call. Raises what ended the stream, once nothing else is left."""
        with self._lock:
            blocks, self._blocks = self._blocks, []
        if not blocks and self._error is not None:
            raise self._error
        found = joined(blocks)
        if not len(found):
            return found
        frames = found.counter if self._frame is None else np.r_[self._frame, found.counter]
        if (np.diff(frames) <= 0).any() or (np.diff(np.r_[self.latest_s, found.time_s]) < 0).any():
            raise DeviceFault(
                "the sensor's counter or clock began anew while it took profiles, so nobody can tell when later ones were taken; has it "
                "restarted? Connect it again and repeat the sweep"
            )
        self._frame, self.latest_s = int(found.counter[-1]), float(found.time_s[-1])
        return Profiles(**{**vars(found), "lost": int(np.sum(np.diff(frames) - 1))})

    def _read(self) -> None:
        sock = self._session.data_socket
        try:
            empty = 0
            while not (self._ending.is_set() and empty >= _QUIET):
                if sock is None or not self._session.is_wanted:
                    return
                if not select.select([sock], [], [], _POLL_S)[0]:
                    empty = empty + 1 if self._ending.is_set() else 0
                    continue
                found = self._session.next_profiles(time.monotonic() + self._timeout_s)
                empty = 0
                if found is not None:
                    with self._lock:
                        self._blocks.append(found)
        except MbcacqError as error:
            self._error = error
        except (OSError, ValueError):  # closed by another thread
            self._error = None


def block_of(data: DataSet) -> ProfileBlock | None:
    """The profiles of a data set, copied; None if it has none. Raises ProtocolError if stamps and profiles do not agree."""
    profiles = [array for array in data.arrays if array.type in (PROFILE_POINTS, UNIFORM_PROFILE)]
    if not profiles:
        return None
    array = profiles[0]
    if data.stamps is None or len(data.stamps) != len(array.array):
        raise ProtocolError(f"the Gocator sent {len(array.array)} profiles with {0 if data.stamps is None else len(data.stamps)} stamps")
    stamps = data.stamps.copy()
    return ProfileBlock(stamps[:, 0], stamps[:, 1] / (TICKS_PER_US * 1e6), stamps[:, 2], stamps[:, 4], array.array.copy(), *_scales(array))


def _scales(array: ArrayMessage) -> tuple[tuple[float, float], tuple[float, float]]:
    try:
        of = array.attributes
        return (of["x_resolution"] / 1e6, of["z_resolution"] / 1e6), (of["x_offset"] / 1e3, of["z_offset"] / 1e3)
    except KeyError as missing:
        raise ProtocolError(f"a Gocator {TYPE_NAMES[array.type]} does not say its {missing}") from None


def joined(blocks: Sequence[ProfileBlock]) -> Profiles:
    """All profiles of the blocks. Neighbours of one form are made into points together."""
    points, counts = [np.empty((0, 2), np.float32)], [np.empty(0, np.int64)]
    for (_, scale, offset), alike in groupby(blocks, lambda b: (b.raw.shape[1:], b.scale, b.offset)):
        raw = np.concatenate([b.raw for b in alike])
        z = raw[..., 1] if raw.ndim == 3 else raw
        valid = z != INVALID
        if raw.ndim == 3:
            x = raw[..., 0][valid] * np.float32(scale[0]) + np.float32(offset[0])
        else:
            grid = (offset[0] + np.arange(z.shape[1]) * scale[0]).astype(np.float32)
            x = np.broadcast_to(grid, z.shape)[valid]
        points.append(np.column_stack([x, z[valid] * np.float32(scale[1]) + np.float32(offset[1])]))
        counts.append(valid.sum(axis=1))
    count = np.concatenate(counts)
    kinds = {"counter": np.int64, "time_s": float, "encoder": np.int64, "inputs": np.int64}
    of = {name: np.concatenate([np.zeros(0, kind), *(getattr(b, name) for b in blocks)]) for name, kind in kinds.items()}
    first = np.cumsum(count) - count
    return Profiles(of["counter"], of["time_s"], of["encoder"], of["inputs"], first, np.concatenate(points))
