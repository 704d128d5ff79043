"""Datagrams through something in the middle."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress

from mbcacq.conformance.faults import DEVICE, DRIVER, Channel, as_read
from mbcacq.conformance.proxy import POLL_S, Proxy


class UdpProxy(Proxy):
    """Datagrams that reach ``address`` go on to ``target``, and its answers back. ``caller``: who sends first, DEVICE or DRIVER."""

    stream = False

    def __init__(self, channel: Channel, target: tuple[str, int], *, caller: str = DEVICE, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(channel)
        self._target, self._caller = target, None
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind((host, port))
        self._back.bind((host, 0))
        self.address: tuple[str, int] = self._front.getsockname()
        other = DRIVER if caller == DEVICE else DEVICE
        self._spawn(self._pump, caller, self._front, lambda data: self._back.sendto(data, self._target))
        self._spawn(self._pump, other, self._back, lambda data: self._caller and self._front.sendto(data, self._caller))

    def stop(self) -> None:
        super().stop()
        self._front.close()
        self._back.close()

    def _pump(self, sender: str, source: socket.socket, send: Callable[[bytes], object]) -> None:
        source.settimeout(POLL_S)

        def receive() -> bytes | None:
            try:
                data, peer = source.recvfrom(1 << 16)
            except (TimeoutError, ConnectionError):
                return b""
            if source is self._front:
                self._caller = peer
            return b"" if self.refusing else data

        def quietly(data: bytes) -> None:
            with suppress(OSError):
                send(data)

        while not self._closing.is_set():  # a connection that a fault closed does not exist here: go on
            with suppress(OSError):
                self._relay(sender, receive, quietly, as_read)
