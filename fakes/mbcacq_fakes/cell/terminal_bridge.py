"""A pseudo-terminal whose bytes go to a TCP port and back: a serial cable to a server that only knows sockets.

Needs POSIX: Windows has no pseudo-terminals.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import tty
from typing import Self

from mbcacq_fakes.protocols.started import Started

POLL_S = 0.05


class TerminalBridge(Started):
    """``url`` is the terminal's name. unplug: cuts the cable."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=5)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.url = os.ttyname(self._slave)
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="terminal-bridge", daemon=True)

    def start(self) -> Self:
        self._thread.start()
        return self

    def stop(self) -> None:
        self._quit.set()
        self._thread.join(2)
        self._socket.close()
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1

    unplug = stop

    def _carry(self) -> None:
        try:
            while not self._quit.is_set():
                for ready in select.select([self._master, self._socket], [], [], POLL_S)[0]:
                    if ready is self._socket:
                        data = self._socket.recv(4096)
                        if not data:
                            return
                        os.write(self._master, data)
                    else:
                        self._socket.sendall(os.read(self._master, 4096))
        except (OSError, ValueError):  # the second of a descriptor that was closed meanwhile
            return
