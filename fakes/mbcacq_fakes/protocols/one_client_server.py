"""A TCP server in a thread, for one client after another."""

from __future__ import annotations

import socket
import threading
from abc import abstractmethod
from typing import Self

from mbcacq_fakes.protocols.started import Started


class OneClientServer(Started):
    """Context manager; ``talk`` serves a client until it goes or ``_quit`` is set. port: 0 for any free one."""

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 0) -> None:
        self._server = socket.create_server((host, port))
        self._server.settimeout(0.1)
        self.port = int(self._server.getsockname()[1])
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @abstractmethod
    def talk(self, connection: socket.socket) -> None:
        """Serve one client. An OSError says that it is gone."""

    def start(self) -> Self:
        self._thread.start()
        return self

    def stop(self) -> None:
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(5.0)
        self._server.close()

    def _run(self) -> None:
        while not self._quit.is_set():
            try:
                connection, _ = self._server.accept()
            except TimeoutError:
                continue
            except OSError:  # closed
                return
            with connection:
                try:
                    self.talk(connection)
                except OSError:
                    continue  # the client is gone
