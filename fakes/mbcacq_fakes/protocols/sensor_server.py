"""Ports, threads and discovery of a fake sensor."""

from __future__ import annotations

import socket
import threading
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Self

from mbcacq_fakes.protocols.datagrams import Responder
from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.listener import Listener
from mbcacq_fakes.protocols.started import Started
from mbcacq_fakes.protocols.tcp_server import ClientThreads

_JOIN_S = 5.0


class SensorServer(Started):
    """Context manager. faults: ``refuse_connections`` of them closes the ports. closing: set when the sensor ends; ``work`` ends with it.

    controls: the conversations of its control port.
    """

    def __init__(self, host: str, faults: Faults, closing: threading.Event, controls: ClientThreads) -> None:
        self.faults = faults
        self._host, self._closing, self._controls = host, closing, controls
        self._listeners: list[Listener] = []
        self._threads: list[threading.Thread] = []
        self._discovery: Responder | None = None

    @abstractmethod
    def open(self) -> Responder | None:
        """Listen (``listen``), and say who answers discovery. Raises OSError for a port that is taken."""

    @abstractmethod
    def work(self) -> dict[str, Callable[[], None]]:
        """What the threads do, by their names."""

    @abstractmethod
    def drop_connections(self) -> None:
        """Close every connection of every client; new ones are welcome."""

    def listen(self, ports: Sequence[tuple[int, Callable[[socket.socket], None]]]) -> list[int]:
        """Take the ports (0: any free one), each with what is done with a connection; returns their numbers."""
        for port, accept in ports:
            self._listeners.append(Listener(self._host, port, accept, lambda: bool(self.faults.get("refuse_connections"))))
        return [listener.port for listener in self._listeners]

    def start(self) -> Self:
        """Returns when every port listens. Raises OSError for a port that is taken."""
        try:
            self._discovery = self.open()
        except OSError:
            self.stop()
            raise
        self._threads = [threading.Thread(target=target, name=name, daemon=True) for name, target in self.work().items()]
        for starter in (*self._listeners, *self._threads, *filter(None, [self._discovery])):
            starter.start()
        return self

    def stop(self) -> None:
        """Idempotent; returns when all threads and sockets are gone."""
        self._closing.set()
        for listener in self._listeners:
            listener.close()
        if self._discovery is not None:
            self._discovery.close()
        self.drop_connections()
        for thread in self._threads:
            thread.join(_JOIN_S)
        self._controls.join(_JOIN_S)
        self._listeners, self._threads, self._discovery = [], [], None

    @property
    def discovery_port(self) -> int | None:
        """Udp port on which discovery answers, None while it is switched off."""
        return self._discovery.port if self._discovery else None
