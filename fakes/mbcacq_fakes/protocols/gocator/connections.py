"""The open control connections of a fake sensor, each served in a thread of its own."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable


class ControlConnections:
    """Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._threads: dict[socket.socket, threading.Thread] = {}

    def serve(self, sock: socket.socket, conversation: Callable[[socket.socket], None]) -> None:
        """Run ``conversation`` in a new thread; the connection is closed when it returns."""

        def run() -> None:
            with sock:
                conversation(sock)
            with self._lock:
                self._threads.pop(sock, None)

        thread = threading.Thread(target=run, name="fake-control", daemon=True)
        with self._lock:
            self._threads[sock] = thread
        thread.start()

    def shut_down(self) -> None:
        """End every connection; the threads end by themselves."""
        with self._lock:
            sockets = list(self._threads)
        for sock in sockets:
            try:
                sock.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def join(self, timeout_s: float) -> None:
        """Wait for each thread that still runs."""
        with self._lock:
            threads = list(self._threads.values())
        for thread in threads:
            thread.join(timeout_s)
