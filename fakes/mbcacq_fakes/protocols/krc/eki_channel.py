"""One EKI channel: a TCP server for one client, buffers and flags."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable
from typing import Any

from mbcacq_fakes.protocols.krc.eki_config import EkiConfig
from mbcacq_fakes.protocols.krc.eki_telegram import Intake, pick


class EkiChannel:
    """``set_flag(number, value)`` reaches $FLAG. ``outlet(socket, bytes)`` sends; faults sit there. ``poll`` reads what came.

    A buffer that is full takes one more element and then the connection is closed, as EKI does. Elements stay until EKI_Clear.
    """

    def __init__(
        self,
        name: str,
        config: EkiConfig,
        host: str,
        port: int,
        set_flag: Callable[[int, bool], None],
        outlet: Callable[[socket.socket, bytes], None],
    ) -> None:
        self.name, self.config, self.host, self.port = name, config, host, port
        self._set_flag, self.outlet = set_flag, outlet
        self.refusing = False
        self._listener: socket.socket | None = None
        self.client: socket.socket | None = None
        self.empty()
        self.opened = self.overflowed = self.received = 0
        self.reserve()

    def empty(self) -> None:
        """Forget what was received: a buffer an element with EKI 2 and 3, whole telegrams with EKI 6."""
        self.buffers: dict[str, deque[Any]] = {n: deque() for n in self.config.received}
        self.telegrams: deque[dict[str, Any]] = deque()

    def listen(self) -> None:
        """EKI_Open: wait for a client, if there is none."""
        if self._listener is None and self.client is None:
            self._listener = socket.create_server((self.host, self.port))
            self._listener.setblocking(False)
            self.opened += 1

    def reserve(self) -> None:
        """Take a port of one's own where any will do."""
        if not self.port:
            with socket.create_server((self.host, 0)) as probe:
                self.port = probe.getsockname()[1]

    # the network

    def poll(self) -> None:
        """Accept, receive, notice the end. Called often; never waits."""
        if self._listener is not None and not self.refusing:
            try:
                self.client, _ = self._listener.accept()
            except (BlockingIOError, OSError):
                pass
            else:
                self._listener.close()  # one client: others are refused
                self._listener = None
                self.client.setblocking(False)
                self.client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._intake = Intake(self.config.root, self.config.buffer_bytes)
                if self.config.alive is not None:
                    self._set_flag(self.config.alive, True)
        if self.client is not None:
            self._receive()

    def _receive(self) -> None:
        assert self.client is not None  # poll looked
        try:
            data = self.client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.drop()
            return
        for telegram in self._intake.feed(data):
            self.received += 1
            if not self._store(telegram):
                self.overflowed += 1
                self.drop()
                return
        if self._intake.too_much:
            self.overflowed += 1
            self.drop()

    def _store(self, telegram: Any) -> bool:
        """False if a buffer overflowed."""
        found = {name: value for name, (path, kind) in self.config.received.items() if (value := pick(telegram, path, kind)) is not None}
        if self.config.system == "iiqka":
            self.telegrams.append(found)
            full = len(self.telegrams) > self.config.limit
        else:
            for name, value in found.items():
                self.buffers[name].append(value)
            full = any(len(b) > self.config.limit for b in self.buffers.values())
        for path, flag in self.config.flags.items():
            if path == telegram.tag or telegram.find("/".join(path.split("/")[1:])) is not None:
                self._set_flag(flag, True)
        return not full

    def drop(self) -> None:
        """The connection is gone, for whatever reason."""
        client, self.client = self.client, None
        if client is not None:
            client.close()
            if self.config.alive is not None:
                self._set_flag(self.config.alive, False)
            if self.config.lost is not None:
                self._set_flag(self.config.lost, True)

    def close(self) -> None:
        self.drop()
        if self._listener is not None:
            self._listener.close()
            self._listener = None
