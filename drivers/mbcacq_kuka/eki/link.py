"""One TCP connection to the controller's channel: whole telegrams in, commands out."""

from __future__ import annotations

import select
import socket
import threading
import time

from mbcacq.devices import ConnectError, ProtocolError
from mbcacq_kuka.eki.framing import Cutter, FramingError
from mbcacq_kuka.eki.telegrams import BEAT, BadTelegram, Hello, State, command, parse

RETRY_S = 0.1
_SEND_S, _LONGEST_S = 1.0, 5.0
_CLOSED = "the controller closed the connection"


class LinkLost(Exception):
    """The connection has ended; the text says how."""


class Link:
    """``receive`` is for one thread, ``send`` for any."""

    def __init__(self, address: str, port: int, timeout_s: float) -> None:
        """Raises ConnectError."""
        self.where = f"{address}:{port}"
        try:
            self._socket = socket.create_connection((address, port), timeout_s)
        except (OSError, UnicodeError) as error:
            raise ConnectError(
                f"the controller's EKI channel {self.where} cannot be reached ({error}); is its link program running in the "
                "submit interpreter, is the address right, does another client hold the channel?"
            ) from error
        self._socket.settimeout(_SEND_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._cutter, self._lock = Cutter("Robot"), threading.Lock()
        self._failed = ""  # why sending failed: what the receiving thread then meets is only a closed socket

    def send(self, data: bytes) -> None:
        """Raises LinkLost."""
        with self._lock:
            try:
                self._socket.sendall(data)
            except OSError as error:
                self._failed = self._failed or _lost(error, "sending failed")
                raise LinkLost(self._failed) from error

    def receive(self, timeout_s: float) -> list[tuple[float, Hello | None, State | None]]:
        """What has come, with the time of its arrival; empty if nothing did. Raises LinkLost, ProtocolError."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return []
            data = self._socket.recv(65536)
        except (OSError, ValueError) as error:  # ValueError: closed by another thread
            raise LinkLost(self._failed or _lost(error, "the connection broke")) from error
        if not data:
            raise LinkLost(_CLOSED)
        now = time.monotonic()
        try:
            return [(now, *parse(telegram)) for telegram in self._cutter.feed(data)]
        except (FramingError, BadTelegram) as error:
            raise ProtocolError(f"the controller at {self.where} sent a useless telegram: {error}; the arm is stopped") from error

    @property
    def has_ended(self) -> bool:
        """Whether the far end has closed it and all that came before was received. Nothing is taken; from any thread."""
        try:
            return bool(select.select([self._socket], [], [], 0.0)[0]) and not self._socket.recv(1, socket.MSG_PEEK)
        except (OSError, ValueError):  # ValueError: closed by another thread
            return True

    def close(self) -> None:
        """Idempotent, from any thread."""
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        self._socket.close()


def _lost(error: Exception, otherwise: str) -> str:
    """How the connection ended. A closed one is met as an end, a reset or a broken pipe, as it happens."""
    return _CLOSED if isinstance(error, (ConnectionResetError, BrokenPipeError)) else f"{otherwise} ({error})"


def dial(address: str, port: int, wait_s: float, quit_event: threading.Event) -> Link:
    """Connect, trying again while the controller makes its channel new, until ``quit_event``. Raises ConnectError."""
    deadline = time.monotonic() + wait_s
    while True:
        try:
            link = Link(address, port, max(RETRY_S, min(wait_s, _LONGEST_S)))
            try:
                link.send(command(BEAT))  # EKI 6 knows of a client only by its first telegram
            except LinkLost as error:
                link.close()
                raise ConnectError(f"the controller's EKI channel {link.where} hung up at once ({error})") from error
            return link
        except ConnectError:
            if quit_event.wait(RETRY_S) or time.monotonic() > deadline:
                raise
