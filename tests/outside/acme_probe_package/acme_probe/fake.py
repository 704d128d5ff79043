"""The thermometer's side of the wire, to try the driver without one."""

from __future__ import annotations

import socketserver
import threading
from typing import Self


class FakeProbe(socketserver.ThreadingTCPServer):
    """Serves on a free port of 127.0.0.1; ``address`` is (host, port). answers: temperatures it gave."""

    daemon_threads = allow_reuse_address = True

    def __init__(self, identity: str = "T-1000 0815") -> None:
        self.identity, self.answers = identity, []
        super().__init__(("127.0.0.1", 0), _Client)
        self.address = self.server_address

    def __enter__(self) -> Self:
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()


class _Client(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        for line in self.rfile:
            if line.strip() == b"T?":
                self.server.answers.append(21.0 + 0.25 * len(self.server.answers))
                self.wfile.write(f"{self.server.answers[-1]:.2f}\n".encode())
            else:
                self.wfile.write(f"{self.server.identity}\n".encode())
