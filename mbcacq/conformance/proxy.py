"""Something in the middle of the link between a driver and a device, through which every message passes by hand; TCP here."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

from mbcacq.conformance.faults import CLOSE, DEVICE, DRIVER, Channel, Cut, as_read

POLL_S = 0.02
_JOIN_S = 0.05  # how long half of a pair waits for the other


class Proxy:
    """Common to all: a channel, and connections that can be cut or refused. ``stream``: bytes may come in any segments."""

    stream = True

    def __init__(self, channel: Channel) -> None:
        self.channel, self.connections = channel, 0
        self.refusing = False  # whether nobody seems to be there for whoever connects from now on
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def ready(self) -> bool:
        """Whether a driver may connect."""
        return True

    def refuse(self, refusing: bool) -> None:
        """Seem not to be there for whoever connects from now on, or be there again."""
        self.refusing = refusing

    def cut(self) -> None:
        """End the connections that stand."""

    def stop(self) -> None:
        self._closing.set()
        self.cut()
        for thread in self._threads:
            thread.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _spawn(self, run: Callable[..., None], *args: object) -> None:
        thread = threading.Thread(target=run, args=args, name=f"proxy-{self.channel.name}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def _relay(self, sender: str, receive: Callable[[], bytes | None], send: Callable[[bytes], object], cut: Cut) -> None:
        """Until the sender ends, the fault closes, or the proxy does. ``receive`` gives b'' when nothing came, None at the end."""
        buffer, quiet, connection = b"", 0.0, object()
        while not self._closing.is_set():
            data = receive()
            quiet = 0.0 if data else quiet + POLL_S
            if (data is None or quiet > _JOIN_S) and (held := self.channel.flush(sender, connection)):
                send(held)
            if data is None:
                return
            buffer += data
            while buffer and (size := cut(buffer)):
                message, buffer = buffer[:size], buffer[size:]
                for piece in self.channel.pass_on(sender, message, connection):
                    if piece is CLOSE:
                        return
                    if isinstance(piece, bytes):
                        send(piece)
                    elif isinstance(piece, int | float) and self._closing.wait(piece):
                        return


class TcpProxy(Proxy):
    """Listens on ``address``; every connection gets one of its own to ``device``."""

    def __init__(
        self, channel: Channel, device: tuple[str, int], *, cut: Cut = as_read, cut_driver: Cut = as_read, host: str = "127.0.0.1"
    ) -> None:
        super().__init__(channel)
        self._device, self._cut = device, {DEVICE: cut, DRIVER: cut_driver}
        self._listener = socket.create_server((host, 0))
        self._listener.settimeout(POLL_S)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._running, self._counting = 0, threading.Lock()
        self._spawn(self._accept)

    @property
    def ready(self) -> bool:
        """Also: no connection of before is still being ended."""
        return self._running == 0

    @property
    def port(self) -> int:
        return self.address[1]

    def cut(self) -> None:
        pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for sock in pair:
                shut(sock)

    def stop(self) -> None:
        super().stop()
        self._listener.close()

    def _accept(self) -> None:
        while not self._closing.is_set():
            try:
                near, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            self.connections += 1
            try:
                if self.refusing:
                    raise ConnectionRefusedError
                far = socket.create_connection(self._device, 5.0)
            except OSError:
                near.close()
                continue
            for sock in (near, far):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                sock.settimeout(POLL_S)
            self._pairs.append((near, far))
            with self._counting:
                self._running += 2
            self._spawn(self._pump, DRIVER, near, far)
            self._spawn(self._pump, DEVICE, far, near)

    def _pump(self, sender: str, source: socket.socket, sink: socket.socket) -> None:
        def receive() -> bytes | None:
            try:
                return source.recv(1 << 16) or None
            except TimeoutError:
                return b""

        try:
            self._relay(sender, receive, lambda data: send_all(sink, data), self._cut[sender])
        except OSError:
            pass
        finally:
            shut(source)
            shut(sink)
            with self._counting:
                self._running -= 1


def send_all(sock: socket.socket, data: bytes) -> None:
    view = memoryview(data)
    while view:
        try:
            view = view[sock.send(view) :]
        except TimeoutError:
            continue


def shut(sock: socket.socket) -> None:
    with suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
    sock.close()
