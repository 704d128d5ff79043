"""The fake sensor: its resources, its exposures, and the channels in front of it."""

from __future__ import annotations

import logging
import queue
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator.data_faults import spoiled
from mbcacq_fakes.protocols.gocator.publish import Publisher
from mbcacq_fakes.protocols.gopxl import control, encode, resources
from mbcacq_fakes.protocols.gopxl.discovery import PORT as DISCOVERY_PORT
from mbcacq_fakes.protocols.gopxl.discovery import GoPxLDiscovery
from mbcacq_fakes.protocols.gopxl.faults import FAULTS
from mbcacq_fakes.protocols.gopxl.resources import Resources
from mbcacq_fakes.protocols.sensor_server import SensorServer
from mbcacq_fakes.protocols.tcp_server import ClientThreads
from mbcacq_fakes.world.frame import ScannerFrame

Source = Callable[[float], ScannerFrame]
_POLL_S, _WAITING = 0.02, 16
_log = logging.getLogger("mbcacq.fakes.gopxl")


class GoPxLPorts(NamedTuple):
    control: int
    data: int


@dataclass(frozen=True, kw_only=True)
class FakeGoPxLOptions:
    """Where the sensor listens (0: any free port), and what it is.

    scan_time_s: how long an exposure takes. volume: (low, high) (3,) mm of the measuring volume, by default each frame's own.
    Messages are as release 1.5 writes them, with a pixel format and label positions. discovery_port: udp, usually 3320; None for no
    discovery.
    """

    host: str = "127.0.0.1"
    control_port: int = 0
    data_port: int = 0
    model: str = "3504"
    serial: int = 12345
    build: str = "1.5.12.3"
    scan_time_s: float = 0.0
    jobs: tuple[str, ...] = ("bench", "other")
    volume: tuple[np.ndarray, np.ndarray] | None = None
    discovery_port: int | None = None


class FakeGoPxL(SensorServer):
    """``source(exposure_us)`` is called once an exposure, in a thread of the fake, and returns the world's frame.

    clock: the world's time in s; without it the sensor counts from its start.
    """

    def __init__(self, source: Source, settings: FakeGoPxLOptions | None = None, clock: Callable[[], float] | None = None) -> None:
        self.source, self.settings, self._clock = source, settings or FakeGoPxLOptions(), clock
        super().__init__(self.settings.host, Faults(FAULTS), threading.Event(), ClientThreads())
        self.resources = Resources(str(self.settings.serial), self.settings.model, self.settings.jobs, self._ask)
        self.data = Publisher()
        self._asked: queue.Queue[None] = queue.Queue(_WAITING)
        self._made, self._born = 0, time.monotonic()

    def open(self) -> GoPxLDiscovery | None:
        s = self.settings
        self.ports = GoPxLPorts(*self.listen(((s.control_port, self._accept_control), (s.data_port, self.data.add))))
        self.resources.gdp_port = self.ports.data
        return None if s.discovery_port is None else GoPxLDiscovery(s.host, s.discovery_port, DISCOVERY_PORT, self._announced)

    def work(self) -> dict[str, Callable[[], None]]:
        return {"fake-gopxl": self._run}

    @property
    def scans(self) -> int:
        """Exposures made so far."""
        return self._made

    def drop_connections(self) -> None:
        self._controls.shut_down()
        self.data.close()

    def _announced(self, address: str) -> dict[str, Any]:
        s = self.settings
        return {
            "AppId": "fake",
            "AppName": "GoPxL",
            "AppVersion": s.build,
            "DeviceModel": s.model,
            "SerialNumber": str(s.serial),
            "Address": address,
            "Mask": "255.255.255.0",
            "Gateway": "",
            "ControlPort": self.ports.control,
            "GdpPort": self.ports.data,
            "WebPort": 8100,
            "HMIStatus": 0,
            "Dhcp": False,
            "IsRemote": False,
            "AddressConflict": False,
        }

    def _accept_control(self, sock: socket.socket) -> None:
        self._controls.serve(sock, lambda client: control.serve(client, self.resources.handle, self.faults))

    def _ask(self) -> None:
        try:
            self._asked.put_nowait(None)
        except queue.Full:
            raise resources.RequestRefused(-981, "too many triggers wait") from None

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                self._asked.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            try:
                self._expose()
            except Exception:
                _log.exception("the exposure failed; no data set is sent")

    def _expose(self) -> None:
        if self.settings.scan_time_s and self._closing.wait(self.settings.scan_time_s):
            return
        frame = self.source(self.resources.exposure_us)
        self._made += 1
        self.resources.scan_count = self._made
        self.data.wait_for_client(0.5)
        if self.resources.gdp_enabled:
            self.data.publish(self._spoiled(self._messages(frame)))

    def _messages(self, frame: ScannerFrame) -> list[bytes]:
        """What the outputs ask for: stamp, surface, measurements, in the order of their ids; the last one marked."""
        modes, s = self.resources.group["scanModeSettings"], self.settings
        time_s = frame.time_s if self._clock and frame.time_s else time.monotonic() - self._born
        index = 0 if self.faults.use("old_frame") else self._made
        parts: list[tuple[int, str, int, bytes]] = []
        for output in sorted(self.resources.outputs, key=lambda o: (o["source"] != resources.STAMP, o["outputId"])):
            source, number = output["source"], output["outputId"]
            uniform = source == resources.UNIFORM
            if source == resources.STAMP:
                parts.append((encode.STAMP, source, number, encode.stamp(index, time_s)))
            elif uniform == bool(modes["uniformSpacingEnabled"]):
                body = encode.surface(frame, uniform, modes["intensityEnabled"], self.resources.exposure_us, s.volume)
                parts.append((encode.UNIFORM_SURFACE if uniform else encode.SURFACE_POINTS, source, number, body))
        for number, value in frame.measurements.items():
            parts.append((encode.MEASUREMENT, f"tools:Height-{number}:outputs:Z", 100 + number, encode.measurement(value)))
        last = len(parts) - 1
        return [encode.message(k, encode.common(src, self._made, i == last, n), body) for i, (k, src, n, body) in enumerate(parts)]

    def _spoiled(self, messages: list[bytes]) -> list[object]:
        """The messages as the active faults let them out."""
        at = next((i for i, m in enumerate(messages) if m[4] in (encode.UNIFORM_SURFACE, encode.SURFACE_POINTS)), None)
        if at is None:
            return list(messages)
        unknown = encode.message(99, encode.common("x", self._made, False, 9), b"nobody knows this")
        own: dict[str, Callable[[Any], list[object]]] = {
            "stamp_only": lambda _: [encode.message(encode.NULL, encode.common("", self._made, True, 0), b"\6\0\1\0\0\0")],
            "null_surface": lambda status: [self._null(status), *messages[at + 1 :]],
            "unknown_type": lambda _: [unknown, *messages[at:]],
        }
        return spoiled(messages, at, self.faults, own)

    def _null(self, status: int) -> bytes:
        body = b"\6\0" + int(status).to_bytes(4, "little", signed=True)
        return encode.message(encode.NULL, encode.common(resources.POINTS, self._made, True, 1), body)
