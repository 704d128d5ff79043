"""The connection under a control channel, of either generation."""

from __future__ import annotations

import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

from mbcacq.devices import ConnectError, DeviceTimeout, hang_up, has_ended
from mbcacq_gocator import wire
from mbcacq_gocator.status import SensorRefused

_Reply = TypeVar("_Reply")


class RequestConnection(ABC):
    """One TCP connection, safe to use from several threads, which take turns.

    After a reply that did not come or made no sense it is closed: a late one could be taken for the next.
    """

    def __init__(
        self,
        address: str,
        port: int,
        connect_timeout_s: float = 3.0,
        reply_limit_s: float | None = None,
        grace_s: float = 0.0,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self._address, self._port = address, port
        self._connect_timeout_s, self._reply_limit_s, self._grace_s = connect_timeout_s, reply_limit_s, grace_s
        self._cancelled, self._turn = cancelled, threading.Lock()
        self._sock: socket.socket | None = None

    @abstractmethod
    def open(self) -> None:
        """Raises ConnectError, IdentityError, DeviceTimeout, ProtocolError."""

    @property
    def is_open(self) -> bool:
        return self._sock is not None

    @property
    def has_ended(self) -> bool:
        """Whether it is closed, by us or by the sensor."""
        return has_ended(self._sock)

    def close(self) -> None:
        """Idempotent, from any thread; a request under way ends at once."""
        sock, self._sock = self._sock, None
        hang_up(sock)

    def _limit(self, usual_s: float) -> float:
        return self._grace_s + min(usual_s, self._reply_limit_s or usual_s)

    def _exchange(
        self, name: str, data: bytes, usual_s: float, read: Callable[[socket.socket, float], _Reply], wait_s: float | None = None
    ) -> _Reply:
        """Send a request and return what ``read`` makes of the socket until a deadline. ``wait_s`` bounds the wait for one's turn."""
        if not self._turn.acquire(timeout=-1 if wait_s is None else wait_s):
            raise DeviceTimeout(f"the Gocator is still busy with another command, so '{name}' was not sent")
        try:
            if (sock := self._sock) is None:
                raise ConnectError(f"the control connection to the Gocator at {self._address}:{self._port} is closed; connect first")
            limit_s = self._limit(usual_s)
            deadline = time.monotonic() + limit_s
            try:
                send(sock, data, name, limit_s)
                return read(sock, deadline)
            except SensorRefused:
                raise
            except BaseException:
                self.close()
                raise
        finally:
            self._turn.release()


def send(sock: socket.socket, data: bytes, name: str, limit_s: float) -> None:
    """Raises DeviceTimeout, Dropped."""
    try:
        sock.settimeout(limit_s)
        sock.sendall(data)
    except TimeoutError:
        raise DeviceTimeout(f"the Gocator does not take in '{name}'; check the network") from None
    except OSError as error:
        raise wire.Dropped(f"the control connection broke while sending '{name}' ({error.strerror or error})") from None
