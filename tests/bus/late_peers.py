"""Devices of our own at the far end of a line that answer in order; an answer may be kept until something has happened."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Mapping


def crc(data: bytes) -> bytes:
    """CRC-16 of Modbus, low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return struct.pack("<H", value)


def always() -> bool:
    return True


class LatePeer:
    """Answers what ``answer(request)`` gives, one after the other. late: what must have happened before the n-th answer leaves, and with it
    those behind it; on a connection that ends before, it is said to nobody.

    idle: asked every few ms; True closes the connection.
    """

    def __init__(self, answer: Callable[[bytes], bytes], cut: Callable[[bytes], int], late: Mapping[int, Callable[[], bool]]) -> None:
        self._answer, self._cut, self.late = answer, cut, dict(late)
        self.requests: list[bytes] = []
        self.connections = 0
        self.idle: Callable[[], bool] = lambda: False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.host, self.port = self._listener.getsockname()[:2]
        self.url = f"socket://{self.host}:{self.port}"
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> LatePeer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._quit.set()
        self._listener.close()
        self._thread.join(5)

    def _serve(self) -> None:
        self._listener.settimeout(0.02)
        while not self._quit.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            self.connections += 1
            with client:
                self._talk(client)

    def _talk(self, client: socket.socket) -> None:
        client.settimeout(0.01)
        pending = b""
        due: list[tuple[int, bytes]] = []
        while not self._quit.is_set() and not self.idle():
            try:
                data = client.recv(4096)
                if not data:
                    return
                pending += data
            except TimeoutError:
                pass
            except OSError:
                return
            while (size := self._cut(pending)) and len(pending) >= size:
                request, pending = pending[:size], pending[size:]
                due.append((len(self.requests), self._answer(request)))
                self.requests.append(request)
            while due and self.late.get(due[0][0], always)():
                client.sendall(due.pop(0)[1])

    def asked(self, number: int) -> Callable[[], bool]:
        """That so many requests have come: whoever asks again has given up the answer to the question before."""
        return lambda: len(self.requests) >= number


def rtu_registers(values: Mapping[int, int]) -> Callable[[bytes], bytes]:
    """Answers of a Modbus RTU device that holds one 16-bit value at each address."""

    def answer(request: bytes) -> bytes:
        unit, function, address, count = struct.unpack_from(">BBHH", request)
        if function == 16:
            body = request[:6]
        else:
            body = struct.pack(f">BBB{count}H", unit, function, 2 * count, *(values[address + k] for k in range(count)))
        return body + crc(body)

    return answer


def rtu_cut(pending: bytes) -> int:
    """Length of the request that ``pending`` begins with, 0 where that cannot be told yet."""
    if len(pending) < 7:
        return 0
    return 9 + pending[6] if pending[1] == 16 else 8


def line_cut(pending: bytes) -> int:
    return pending.find(b"\n") + 1


class Clock:
    """A clock that the test turns, s."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class IdleCloser(LatePeer):
    """Closes a connection on which nothing was asked for ``limit_s``, as many PLCs and serial servers do, by a clock of the test."""

    def __init__(self, answer: Callable[[bytes], bytes], cut: Callable[[bytes], int], clock: Clock, limit_s: float = 5.0) -> None:
        super().__init__(self._noted(answer), cut, {})
        self._clock, self._limit, self._used = clock, limit_s, 0.0
        self.closed = 0
        self.idle = self._is_idle

    def _noted(self, answer: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
        def noted(request: bytes) -> bytes:
            self._used = self._clock()
            return answer(request)

        return noted

    def _is_idle(self) -> bool:
        if self._clock() - self._used <= self._limit:
            return False
        self._used = self._clock()
        self.closed += 1
        return True
