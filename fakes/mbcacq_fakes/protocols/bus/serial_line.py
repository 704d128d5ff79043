"""The far end of a serial line: a pseudo-terminal, or a TCP port as behind a serial server.

Pseudo-terminals need POSIX; on Windows only the TCP port is there.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

from mbcacq_fakes.protocols.listener import Listener
from mbcacq_fakes.protocols.started import Started

POLL_S = 0.05
LONGEST = 4096


class _Terminal:
    """The master end of a pseudo-terminal, read and written like a socket."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor

    def recv(self, most: int) -> bytes:
        return os.read(self._descriptor, most)

    def sendall(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._descriptor, data) :]


class SerialLine(Started):
    """A device that talks in lines. ``answer(line)`` gives the reply to a line heard (None: none); ``speak()`` a line said unasked each
    ``period_s`` of silence.

    pty: on a pseudo-terminal, whose name is ``url`` (``link``: a path to make that leads there); else on a TCP port. end: ends each line.
    Faults: ``silent`` says nothing; ``corrupt(bytes)`` changes what is said, None breaks the connection. heard: lines that came.
    """

    def __init__(
        self,
        answer: Callable[[str], str | None] = lambda line: None,
        speak: Callable[[], str | None] | None = None,
        *,
        period_s: float = 0.02,
        pty: bool = False,
        link: str | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        end: str = "\r\n",
    ) -> None:
        self._answer, self._speak, self._period, self._end = answer, speak, period_s, end
        self.silent = False
        self.heard: list[str] = []
        self.corrupt: Callable[[bytes], bytes | None] = lambda data: data
        self._quit = threading.Event()
        self._threads: list[threading.Thread] = []
        self._listener: Listener | None = None
        self._link, self._master, self._slave = link, -1, -1
        if pty:
            self._open_terminal()
        else:
            self._listener = Listener(host, port, lambda client: self._begin(lambda: self._serve(client)))
            self.address: tuple[str, int] = host, self._listener.port
            self.url = f"socket://{self.address[0]}:{self.address[1]}"

    def start(self) -> Self:
        if self._listener is not None:
            self._listener.start()
        else:
            self._begin(lambda: self._talk(_Terminal(self._master)))
        return self

    def stop(self) -> None:
        """Idempotent; whoever is connected meets the end of the line."""
        self._quit.set()
        if self._listener is not None:
            self._listener.close()
        for thread in self._threads:
            thread.join(2)
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1
        if self._link is not None:
            Path(self._link).unlink(missing_ok=True)
            self._link = None

    def _open_terminal(self) -> None:
        if sys.platform == "win32":
            raise OSError("there are no pseudo-terminals on Windows; use a TCP port")
        import tty

        self._master, self._slave = os.openpty()  # ours stays open, so that a client may come and go
        tty.setraw(self._slave)
        self.url = os.ttyname(self._slave)
        if self._link is not None:
            Path(self._link).symlink_to(self.url)

    def _begin(self, work: Callable[[], None]) -> None:
        thread = threading.Thread(target=work, name="fake-serial", daemon=True)
        self._threads.append(thread)
        thread.start()

    def _serve(self, client: socket.socket) -> None:
        with client:
            self._talk(client)

    def _talk(self, line: socket.socket | _Terminal) -> None:
        pending = b""
        try:
            while not self._quit.is_set():
                data = b""
                if select.select([line], [], [], self._period if self._speak else POLL_S)[0]:
                    data = line.recv(LONGEST)
                    if not data:
                        return
                *lines, pending = (pending + data).replace(b"\r", b"\n").split(b"\n")
                pending = pending[-LONGEST:]
                said = [self._reply(text.decode("ascii", "replace").strip()) for text in lines if text.strip()]
                if not data and self._speak is not None:
                    said.append(self._speak())
                for text in said:
                    if text is not None and not self._say(line, text):
                        return
        except (OSError, ValueError):  # the second of a descriptor that was closed meanwhile
            return

    @property
    def _muted(self) -> bool:
        return self.silent

    def _reply(self, line: str) -> str | None:
        self.heard.append(line)
        return self._answer(line)

    def _say(self, line: socket.socket | _Terminal, text: str) -> bool:
        """False: the connection was to be broken."""
        if self._muted:
            return True
        data = self.corrupt(f"{text}{self._end}".encode())
        if data is None:
            return False
        line.sendall(data)
        return True
