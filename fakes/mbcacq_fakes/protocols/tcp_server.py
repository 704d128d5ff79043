"""Clients of a fake device on TCP, each served in a thread of its own."""

from __future__ import annotations

import socket
import threading
from abc import abstractmethod
from collections.abc import Callable
from contextlib import nullcontext, suppress
from typing import Self

from mbcacq_fakes.protocols.listener import Listener
from mbcacq_fakes.protocols.started import Started


class ClientThreads:
    """Open connections with their threads. Thread-safe."""

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

        thread = threading.Thread(target=run, name="fake-client", daemon=True)
        with self._lock:
            self._threads[sock] = thread
        thread.start()

    def shut_down(self) -> None:
        """End every connection; the threads end by themselves."""
        with self._lock:
            sockets = list(self._threads)
        for sock in sockets:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def join(self, timeout_s: float) -> None:
        """Wait for each thread that still runs."""
        with self._lock:
            threads = list(self._threads.values())
        for thread in threads:
            thread.join(timeout_s)


class TcpServer(Started):
    """``talk`` serves a client until it goes or ``_quit`` is set. port: 0 for any free one. one: clients are served one after another."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0, one: bool = True) -> None:
        self._quit, self._clients = threading.Event(), ClientThreads()
        self._turn = threading.Lock() if one else nullcontext()
        self._listener = Listener(host, port, lambda sock: self._clients.serve(sock, self._serve))
        self.port = self._listener.port

    @abstractmethod
    def talk(self, connection: socket.socket) -> None:
        """Serve one client. An OSError says that it is gone."""

    def start(self) -> Self:
        self._listener.start()
        return self

    def stop(self) -> None:
        self._quit.set()
        self._listener.close()
        self._clients.shut_down()
        self._clients.join(5.0)

    def _serve(self, connection: socket.socket) -> None:
        with self._turn, suppress(OSError):
            self.talk(connection)
