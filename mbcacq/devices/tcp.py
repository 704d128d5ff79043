"""TCP connections to devices: opened, watched for their end, closed. What is said over them is the driver's own."""

from __future__ import annotations

import select
import socket
import threading
import time
from contextlib import suppress

# s of silence before a connection is probed, and between two probes: firewalls forget a silent one after minutes, without a word.
_KEEP_ALIVE = {"TCP_KEEPIDLE": 20, "TCP_KEEPINTVL": 5}


def reason(error: OSError) -> str:
    """Why something at a connection failed, in a few words for the middle of a sentence: 'no answer', 'connection refused'."""
    return "no answer" if isinstance(error, TimeoutError) else (error.strerror or str(error)).lower()


def open_tcp(address: str, port: int, timeout_s: float, receive_buffer: int = 0) -> socket.socket:
    """A connection that sends small packets at once and notices a far end that is gone. Raises OSError.

    Parameters
    ----------
    address, port : str, int
        Of the device.
    timeout_s : float
        For the connection, and for what is sent and received over it until another one is set.
    receive_buffer : int
        Bytes that the operating system keeps for us; 0 for as many as it likes.
    """
    found = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)
    for number, (family, kind, protocol, _, target) in enumerate(found, 1):
        sock = socket.socket(family, kind, protocol)
        try:
            sock.settimeout(timeout_s)
            if receive_buffer:  # counts only where it is set before the connection
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
            sock.connect(target)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, seconds in _KEEP_ALIVE.items():
                if hasattr(socket, name):  # macOS lacks the first
                    sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), seconds)
            return sock
        except OSError:
            sock.close()
            if number == len(found):
                raise
    raise OSError(f"{address} has no address")


def has_ended(sock: socket.socket | None) -> bool:
    """Whether the far end has closed a connection and all that came before was received. Nothing is taken; from any thread."""
    try:
        return sock is None or (bool(select.select([sock], [], [], 0)[0]) and not sock.recv(1, socket.MSG_PEEK))
    except TimeoutError:  # another thread has read what there was
        return False
    except (OSError, ValueError):  # reset; closed by another thread
        return True


def hang_up(sock: socket.socket | None) -> None:
    """Close, waking a thread that reads. Never raises."""
    if sock is not None:
        with suppress(OSError):
            sock.shutdown(socket.SHUT_RDWR)
        sock.close()


class LinkLost(Exception):
    """The connection has ended; the text says how."""


class TcpLink:
    """A connection over which telegrams come unasked. ``receive`` is for one thread, ``send``, ``has_ended`` and ``close`` for any.

    peer: how messages name who is at the other end, e.g. 'the controller'. send_s: longest wait for room to send.
    """

    def __init__(self, peer: str, address: str, port: int, timeout_s: float, send_s: float) -> None:
        """Raises OSError."""
        self._peer, self._lock = peer, threading.Lock()
        self._failed = ""  # why sending failed: what the receiving thread then meets is only a closed socket
        self._socket = open_tcp(address, port, timeout_s)
        self._socket.settimeout(send_s)

    def send(self, data: bytes) -> None:
        """Raises LinkLost."""
        with self._lock:
            try:
                self._socket.sendall(data)
            except OSError as error:
                self._failed = self._failed or self._lost(error, "sending failed")
                raise LinkLost(self._failed) from error

    def receive(self, timeout_s: float) -> tuple[float, bytes]:
        """When (time.monotonic) what came; nothing after the time-out. Raises LinkLost."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return time.monotonic(), b""
            data = self._socket.recv(65536)
        except (OSError, ValueError) as error:  # ValueError: closed by another thread
            raise LinkLost(self._failed or self._lost(error, "the connection broke")) from error
        if not data:
            raise LinkLost(f"{self._peer} closed the connection")
        return time.monotonic(), data

    @property
    def has_ended(self) -> bool:
        return has_ended(self._socket)

    def close(self) -> None:
        hang_up(self._socket)

    def _lost(self, error: Exception, otherwise: str) -> str:
        """How the connection ended. A closed one is met as an end, a reset or a broken pipe, as it happens."""
        if isinstance(error, ConnectionResetError | BrokenPipeError):
            return f"{self._peer} closed the connection"
        return f"{otherwise} ({getattr(error, 'strerror', None) or error})"
