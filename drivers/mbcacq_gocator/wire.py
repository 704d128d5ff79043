"""Sockets with deadlines, and the one buffer a data set is received into."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np

from mbcacq.devices import Aborted, ConnectError, DeviceTimeout, ProtocolError, open_tcp, reason
from mbcacq_gocator.layouts import HEADER, LAST, MAX_MESSAGE

MAX_SET = 512 * 2**20
_POLL_S = 0.1
_FIRST_STEP = 4 * 2**20


class Dropped(ConnectError):
    """The sensor ended a connection that stood; connecting anew may help."""


def connect(address: str, port: int, what: str, timeout_s: float, receive_buffer: int = 0) -> socket.socket:
    """A TCP connection without delay of small packets. Raises ConnectError naming address, port and what listens there."""
    try:
        return open_tcp(address, port, timeout_s, receive_buffer)
    except OSError as error:
        raise ConnectError(
            f"the Gocator's {what} port at {address}:{port} cannot be reached ({reason(error)}); "
            "check its power, cable and address, and that no firewall stands between"
        ) from None


def receive_exactly(
    sock: socket.socket, view: memoryview, what: str, deadline: float, cancelled: Callable[[], bool] = lambda: False, started: bool = False
) -> None:
    """Fill ``view``. Raises Dropped, DeviceTimeout (at ``deadline``, time.monotonic), Aborted; all within 0.1 s of their cause."""
    done = 0
    while done < len(view):
        if cancelled():
            raise Aborted(f"waiting for the Gocator's {what} was stopped")
        remaining = deadline - time.monotonic()
        if remaining <= 0:
            part = f"stopped after {done} of {len(view)} bytes" if done or started else "did not come in time"
            raise DeviceTimeout(f"the Gocator's {what} {part}; check the network and that the sensor is not overloaded")
        try:
            sock.settimeout(min(_POLL_S, remaining))
            got = sock.recv_into(view[done:])
        except TimeoutError:
            continue
        except OSError as error:
            raise Dropped(f"the connection for the Gocator's {what} broke ({error.strerror or error}); check the cable") from None
        if not got:
            where = f" in the middle of it ({done} of {len(view)} bytes)" if done or started else ""
            raise Dropped(f"the sensor closed the connection for the Gocator's {what}{where}; it may have restarted")
        done += got


class MessageReader:
    """Messages of the data or health channel, received into one buffer that grows to the largest data set and is then reused.

    A returned message is a view into that buffer: decode it before ``rewind``. limit: the largest size of a message, by its type.
    """

    def __init__(
        self,
        sock: socket.socket,
        what: str,
        cancelled: Callable[[], bool] = lambda: False,
        limit: Callable[[int], int] = lambda kind: MAX_MESSAGE,
    ) -> None:
        self._sock, self._what, self._cancelled, self._limit = sock, what, cancelled, limit
        self._buffer = np.empty(65536, np.uint8)
        self._used = 0

    def rewind(self) -> None:
        """Start a new data set; messages returned before are no longer valid."""
        self._used = 0

    def read(self, deadline: float) -> np.ndarray:
        """The next whole message, (size,) uint8. Raises Dropped, DeviceTimeout, Aborted, ProtocolError."""
        header = memoryview(bytearray(HEADER.size))
        receive_exactly(self._sock, header, self._what, deadline, self._cancelled)
        size, control = HEADER.unpack(header)
        if not HEADER.size <= size <= self._limit(control & ~LAST) or self._used + size > MAX_SET:
            raise ProtocolError(
                f"the Gocator's {self._what} announces a message of {size} bytes (type {control & ~LAST}); "
                "something else answers at this port, or the stream is out of step"
            )
        start, have = self._used, HEADER.size
        self._reserve(start + have)
        self._buffer[start : start + have] = np.frombuffer(header, np.uint8)
        while have < size:
            # Space is made as bytes come in, so a wrong size cannot claim memory that nothing fills.
            end = min(size, max(have + _FIRST_STEP, 2 * have, len(self._buffer) - start))
            self._reserve(start + end)
            receive_exactly(self._sock, self._buffer.data[start + have : start + end], self._what, deadline, self._cancelled, started=True)
            have = end
        self._used = start + size
        return self._buffer[start : start + size]

    def _reserve(self, size: int) -> None:
        if size > len(self._buffer):
            grown = np.empty(max(size, len(self._buffer) * 3 // 2), np.uint8)
            grown[: len(self._buffer)] = self._buffer
            self._buffer = grown
