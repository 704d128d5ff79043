"""A connection to a sensor of either generation, and the stream of profiles that a line scanner sends over it."""

from __future__ import annotations

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

from mbcacq.devices import DeviceFault, DeviceTimeout, MbcacqError, Profiles, hang_up, has_ended
from mbcacq_gocator import wire
from mbcacq_gocator.layouts import MAX_MESSAGE
from mbcacq_gocator.profiles import ProfileBlock, joined
from mbcacq_gocator.request_connection import RequestConnection

_RECEIVE_BUFFER = 4 * 2**20
_POLL_S = 0.05
_QUIET = 12  # polls without a data set, after which a stopped sensor has sent all; a busy computer polls more slowly
C = TypeVar("C", bound=RequestConnection)


class SensorSession(ABC, Generic[C]):
    """Its connections, with what has been agreed over them.

    data, reader: of the data channel, None once it is closed. exposure: 'as set', or what the sensor says of another one. geometry:
    scale, offset and size of the last scan, as its message says them.
    """

    def __init__(self, control: C, model: str, cancelled: Callable[[], bool]) -> None:
        self.control, self._model, self._cancelled = control, model, cancelled
        self.data: socket.socket | None = None
        self.reader: wire.MessageReader | None = None
        self.running, self.exposure = False, "as set"
        self.geometry: tuple[object, ...] = ()

    def open(self) -> None:
        """Raises ConnectError, IdentityError, ConfigError, DeviceFault, DeviceTimeout, ProtocolError, Aborted."""
        try:
            self.control.open()
            self._agree()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _agree(self) -> None:
        """Identify the sensor, set it up, open the other channels."""

    def _open_data(
        self, address: str, port: int, what: str, timeout_s: float, limit: Callable[[int], int] = lambda kind: MAX_MESSAGE
    ) -> None:
        self.data = wire.connect(address, port, what, timeout_s, _RECEIVE_BUFFER)
        self.reader = wire.MessageReader(self.data, "scan", self._cancelled, limit)

    @property
    def has_ended(self) -> bool:
        """Whether the sensor has closed a connection since it was used, e.g. as idle."""
        return self.control.has_ended or has_ended(self.data)

    @property
    def is_wanted(self) -> bool:
        """Whether nobody has stopped what waits for the sensor."""
        return not self._cancelled()

    def close(self) -> None:
        self.control.close()
        hang_up(self.data)
        self.data = self.reader = None
        self.running = False

    @abstractmethod
    def job(self) -> str:
        """Name of the job that is loaded now."""

    @abstractmethod
    def exposure_set(self) -> str:
        """As ``exposure``, of the settings now: profiles come without one."""

    @abstractmethod
    def start(self) -> None:
        """Let the sensor run, waiting for triggers, if it does not already."""

    @abstractmethod
    def stop(self) -> None: ...

    @abstractmethod
    def next_profiles(self, deadline: float) -> ProfileBlock | None:
        """The profiles of the next data set, copied; None if it has none, or the session is closed.

        Raises DeviceTimeout, ConnectError, ProtocolError, Aborted."""


class ProfileStream:
    """A thread that takes data sets off the wire, after it has started the sensor. timeout_s: of one data set. after_s: time of the last
    profile of an earlier stream, -inf without one."""

    def __init__(self, session: SensorSession[Any], timeout_s: float, after_s: float = -np.inf) -> None:
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
        sock = self._session.data
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
