"""A fake serial sensor, on a TCP port as behind a serial server."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable


class FakeSerialSensor:
    """Sends text lines to every client of a TCP port (pyserial opens it as socket://host:port); answers ``ask`` lines with ``answers``."""

    def __init__(self, line: Callable[[], str], period_s: float = 0.02, answers: dict[str, str] | None = None, host: str = "127.0.0.1",
                 port: int = 0) -> None:
        self._line, self._period, self._answers = line, period_s, answers or {}
        self.silent = False
        self._listener = socket.create_server((host, port))
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._quit = threading.Event()
        self._threads = [threading.Thread(target=self._accept, daemon=True)]

    @property
    def url(self) -> str:
        return f"socket://{self.address[0]}:{self.address[1]}"

    def start(self) -> FakeSerialSensor:
        self._threads[0].start()
        return self

    def stop(self) -> None:
        self._quit.set()
        self._listener.close()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(2)

    def __enter__(self) -> FakeSerialSensor:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _accept(self) -> None:
        self._listener.settimeout(0.1)
        while not self._quit.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            thread = threading.Thread(target=self._talk, args=(client,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _talk(self, client: socket.socket) -> None:
        heard = b""
        with client:
            client.settimeout(self._period)
            while not self._quit.is_set():
                try:
                    data = client.recv(1024)
                    if not data:
                        return
                    heard = (heard + data)[-1024:]
                except TimeoutError:
                    data = b""
                except OSError:
                    return
                *lines, heard = heard.split(b"\n")
                out = [self._answers[q] for q in (line.decode("ascii", "replace").strip() for line in lines) if q in self._answers]
                if not data and not self.silent:
                    out.append(self._line())
                try:
                    client.sendall("".join(f"{text}\r\n" for text in out).encode())
                except OSError:
                    return
