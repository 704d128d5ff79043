"""The fake sensor: opens the ports, starts the threads, and hands every part the shared state."""

from __future__ import annotations

import socket
from collections.abc import Callable
from functools import partial

from mbcacq_fakes.protocols.gocator.channel import converse
from mbcacq_fakes.protocols.gocator.discovery import Discovery
from mbcacq_fakes.protocols.gocator.exposures import Source, expose_on_request
from mbcacq_fakes.protocols.gocator.health import health_messages, publish_health
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions, Ports
from mbcacq_fakes.protocols.gocator.state import SensorState
from mbcacq_fakes.protocols.line_sensor import LineSource, ProfileSender
from mbcacq_fakes.protocols.sensor_server import SensorServer


class FakeGocator(SensorServer):
    """Context manager. ``source(exposure_us)`` is called once an exposure, in a thread of the fake, and returns the ScannerFrame.

    ``state`` is what the sensor is now; ``files`` and ``faults`` of it may be changed while the sensor runs. ``ports`` is known once
    the sensor has started. line: what a line scanner sees, for options with ``profiles``.
    """

    def __init__(self, source: Source, options: FakeGocatorOptions | None = None, line: LineSource | None = None) -> None:
        self.options = options or FakeGocatorOptions()
        self.state = SensorState(self.options)
        super().__init__(self.options.host, self.state.faults, self.state.closing, self.state.control)
        self.files, self._source, self._line = self.state.files, source, line

    def open(self) -> Discovery | None:
        o = self.options
        channels = ((o.control_port, self._accept_control), (o.health_port, self._accept_health), (o.data_port, self.state.data.add))
        self.ports = Ports(*self.listen(channels))
        return Discovery(self.state, self.ports, o.discovery_port, o.broadcast) if o.discovery else None

    def work(self) -> dict[str, Callable[[], None]]:
        threads: dict[str, Callable[[], None]] = {
            "fake-gocator-exposures": partial(expose_on_request, self.state, self._source),
            "fake-gocator-health": partial(publish_health, self.state),
        }
        if self._line is not None:
            stream = ProfileSender(self.state, self._line, self.state.serial)
            self.state.catch_up = stream.catch_up
            threads["fake-gocator-profiles"] = stream.run
        return threads

    def drop_connections(self) -> None:
        self.state.drop_connections()

    def _accept_control(self, sock: socket.socket) -> None:
        self.state.control.serve(sock, lambda connection: converse(self.state, connection))

    def _accept_health(self, sock: socket.socket) -> None:
        self.state.health.add(sock, health_messages(self.state))
