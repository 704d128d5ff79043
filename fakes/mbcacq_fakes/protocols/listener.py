"""A TCP port that can stop listening for a while."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress

_POLL_S = 0.05


class Listener:
    """Accepts in a thread of its own and hands every connection to ``accept``."""

    def __init__(self, host: str, port: int, accept: Callable[[socket.socket], None], refusing: Callable[[], bool] = lambda: False) -> None:
        self._host, self._accept, self._refusing = host, accept, refusing
        self._closing = threading.Event()
        self._sock: socket.socket | None = self._listen(port)
        self.port: int = self._sock.getsockname()[1]
        self._thread = threading.Thread(target=self._run, name=f"fake-{self.port}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._sock is not None:
            with suppress(OSError):
                self._sock.shutdown(socket.SHUT_RDWR)  # wakes accept at once where the system does that, else it polls
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._sock is not None:
            self._sock.close()

    def _listen(self, port: int) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind((self._host, port))
            sock.listen(16)
            sock.settimeout(_POLL_S)
        except OSError:
            sock.close()
            raise
        return sock

    def _run(self) -> None:
        while not self._closing.is_set():
            if self._refusing():
                if self._sock is not None:
                    self._sock.close()
                    self._sock = None
                self._closing.wait(_POLL_S)
                continue
            try:
                if self._sock is None:
                    self._sock = self._listen(self.port)
                connection, _ = self._sock.accept()
                connection.settimeout(None)
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except TimeoutError:
                continue
            except OSError:  # woken to close, no descriptor left for a connection, or another program has the port for now
                self._closing.wait(_POLL_S)
                continue
            self._accept(connection)
