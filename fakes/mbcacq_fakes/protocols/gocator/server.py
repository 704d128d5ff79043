"""The fake sensor: opens the ports, starts the threads, and hands every part the shared state."""

from __future__ import annotations

import socket
import threading
from typing import Self

from mbcacq_fakes.protocols.gocator.channel import converse
from mbcacq_fakes.protocols.gocator.discovery import Discovery
from mbcacq_fakes.protocols.gocator.exposures import Source, expose_on_request
from mbcacq_fakes.protocols.gocator.health import health_messages, publish_health
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions, Ports
from mbcacq_fakes.protocols.gocator.profiles import LineSource, ProfileSender
from mbcacq_fakes.protocols.gocator.state import SensorState
from mbcacq_fakes.protocols.listener import Listener
from mbcacq_fakes.protocols.started import Started

_JOIN_S = 5.0


class FakeGocator(Started):
    """Context manager. ``source(exposure_us)`` is called once an exposure, in a thread of the fake, and returns the ScannerFrame.

    ``state`` is what the sensor is now; ``files`` and ``faults`` of it may be changed while the sensor runs. ``ports`` is known once
    the sensor has started. line: what a line scanner sees, for options with ``profiles``.
    """

    def __init__(self, source: Source, options: FakeGocatorOptions | None = None, line: LineSource | None = None) -> None:
        self.options = options or FakeGocatorOptions()
        self.state = SensorState(self.options)
        self.files, self.faults = self.state.files, self.state.faults
        self._source, self._line = source, line
        self._listeners: list[Listener] = []
        self._threads: list[threading.Thread] = []
        self._discovery: Discovery | None = None

    def start(self) -> Self:
        """Returns when every port listens. Raises OSError for a port that is taken."""
        try:
            self._listen()
        except OSError:
            self.stop()
            raise
        self._threads = [
            threading.Thread(target=expose_on_request, args=(self.state, self._source), name="fake-gocator-exposures", daemon=True),
            *([] if self._line is None else [self._stream(self._line)]),
            threading.Thread(target=publish_health, args=(self.state,), name="fake-gocator-health", daemon=True),
        ]
        for starter in (*self._listeners, *self._threads, *filter(None, [self._discovery])):
            starter.start()
        return self

    def stop(self) -> None:
        """Idempotent; returns when all threads and sockets are gone."""
        self.state.closing.set()
        for listener in self._listeners:
            listener.close()
        if self._discovery is not None:
            self._discovery.close()
        self.state.drop_connections()
        for thread in self._threads:
            thread.join(_JOIN_S)
        self.state.control.join(_JOIN_S)
        self._listeners, self._threads, self._discovery = [], [], None

    def _stream(self, line: LineSource) -> threading.Thread:
        stream = ProfileSender(self.state, line)
        self.state.catch_up = stream.catch_up
        return threading.Thread(target=stream.run, name="fake-gocator-profiles", daemon=True)

    @property
    def discovery_port(self) -> int | None:
        """Udp port on which discovery answers, None while it is switched off."""
        return self._discovery.port if self._discovery else None

    def _listen(self) -> None:
        o = self.options
        channels = ((o.control_port, self._accept_control), (o.health_port, self._accept_health), (o.data_port, self.state.data.add))
        for port, accept in channels:
            self._listeners.append(Listener(o.host, port, accept, self._refusing))
        self.ports = Ports(*(listener.port for listener in self._listeners))
        if o.discovery:
            self._discovery = Discovery(self.state, self.ports, o.discovery_port, o.broadcast)

    def _refusing(self) -> bool:
        return bool(self.faults.get("refuse_connections"))

    def _accept_control(self, sock: socket.socket) -> None:
        self.state.control.serve(sock, lambda connection: converse(self.state, connection))

    def _accept_health(self, sock: socket.socket) -> None:
        self.state.health.add(sock, health_messages(self.state))
