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
from mbcacq_fakes.protocols.gopxl.discovery import GoPxLDiscovery
from mbcacq_fakes.protocols.gopxl.faults import FAULTS
from mbcacq_fakes.protocols.gopxl.resources import Resources
from mbcacq_fakes.protocols.line_sensor import PATIENCE_S, LineSensorOptions, LineSource, ProfileSender
from mbcacq_fakes.protocols.sensor_server import SensorServer
from mbcacq_fakes.protocols.tcp_server import ClientThreads
from mbcacq_fakes.world.frame import ScannerFrame

Source = Callable[[float], ScannerFrame]
Part = tuple[int, str, int, bytes]  # type, source, output id and body of a message
STAMPS = (resources.STAMP, resources.LASER_STAMP)
_POLL_S, _WAITING, _MOST_RECORDED = 0.02, 16, 50
_log = logging.getLogger("mbcacq.fakes.gopxl")


class GoPxLPorts(NamedTuple):
    control: int
    data: int


@dataclass(frozen=True, kw_only=True)
class FakeGoPxLOptions(LineSensorOptions):
    """Where the sensor listens (0: any free port), and what it is.

    scan_time_s: how long an exposure takes. volume: (low, high) (3,) mm of the measuring volume, by default each frame's own.
    stamps: whether it offers stamps. discovery_port: udp, usually 3320; None for no discovery. The others: see LineSensorOptions.
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

    clock: the world's time in s; without it the sensor counts from its start. line: what a line scanner sees, for options with
    ``profiles``.
    """

    def __init__(
        self,
        source: Source,
        options: FakeGoPxLOptions | None = None,
        clock: Callable[[], float] | None = None,
        line: LineSource | None = None,
    ) -> None:
        self.source, self.options, self._clock = source, options or FakeGoPxLOptions(), clock
        self._line, self.closing = line, threading.Event()
        o = self.options
        super().__init__(o.host, Faults(FAULTS), self.closing, ClientThreads())
        rate_hz = o.frame_rate_hz or 5.0 if o.profiles else 0.0
        self.resources = Resources(str(o.serial), o.model, o.jobs, self._ask, rate_hz)
        self._watchers = control.Watchers(lambda path: self.resources.handle("read", path, {}, {}))
        self.resources.changed = self._watchers.tell
        self.data = Publisher()
        self._asked: queue.Queue[None] = queue.Queue(_WAITING)
        self._made, self._born, self._next_free = 0, time.monotonic(), 0.0

    def open(self) -> GoPxLDiscovery | None:
        s = self.options
        self.ports = GoPxLPorts(*self.listen(((s.control_port, self._accept_control), (s.data_port, self.data.add))))
        self.resources.gdp_port = self.ports.data
        return None if s.discovery_port is None else GoPxLDiscovery(s.host, s.discovery_port, self._announced)

    def work(self) -> dict[str, Callable[[], None]]:
        threads: dict[str, Callable[[], None]] = {"fake-gopxl": self._run}
        if self._line is not None:
            stream = ProfileSender(self, self._line, self.options.serial)
            self.resources.catch_up = stream.catch_up
            threads["fake-gopxl-profiles"] = stream.run
        return threads

    def profile_period_s(self) -> float | None:
        return self.resources.free_period_s

    def restarts(self) -> bool:
        return bool(self.faults.use("restart"))

    def send_profile(self, index: int, own_s: float, profile: np.ndarray) -> None:
        volume = self.options.volume or (np.array([-100.0, 0.0, -100.0]), np.array([100.0, 0.0, 100.0]))
        parts: list[Part] = []
        for source, number in self._outputs():
            if source == resources.LASER_STAMP:
                parts.append((encode.STAMP, source, number, encode.stamp(index, max(own_s, 0.0))))
            elif source == resources.LASER_POINTS:
                parts.append((encode.PROFILE_POINTS, source, number, encode.profile_points(profile, volume, self.resources.exposure_us)))
            elif source == resources.LASER_PROFILE:
                frame = ScannerFrame(np.stack([profile[:, 0], 0 * profile[:, 0], profile[:, 1]], axis=1)[None].astype(np.float32))
                parts.append((encode.UNIFORM_PROFILE, source, number, encode.profile(frame, self.resources.exposure_us)))
        if not index:
            self.data.wait_for_client(0.5)
        if self.resources.gdp_enabled:
            self.data.publish(_packed(parts, index), PATIENCE_S)

    @property
    def scans(self) -> int:
        """Exposures made so far."""
        return self._made

    def drop_connections(self) -> None:
        self._controls.shut_down()
        self.data.close()

    def _announced(self, address: str) -> dict[str, Any]:
        s = self.options
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
        self._controls.serve(
            sock, lambda client: control.serve(control.ControlClient(client, self._watchers), self.resources.handle, self.faults)
        )

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
                self._watchers.stream()
                if not self._due():
                    continue
            try:
                self._expose()
            except Exception:
                _log.exception("the exposure failed; no data set is sent")

    def _due(self) -> bool:
        """Whether the time trigger, or a replay, exposes now."""
        period, now = None if self._line else self.resources.free_period_s, time.monotonic()
        if period is None or now < self._next_free:
            self._next_free = self._next_free if period is not None else 0.0
            return False
        self._next_free = now + period
        return True

    def _frame(self) -> ScannerFrame:
        if self.resources.replaying and (kept := self.resources.next_recorded()) is not None:
            return kept
        frame = self.source(self.resources.exposure_us)
        if self.resources.recording and len(self.resources.recorded) < _MOST_RECORDED:
            self.resources.recorded.append(frame)
        return frame

    def _expose(self) -> None:
        if self.options.scan_time_s and self._closing.wait(self.options.scan_time_s):
            return
        frame = self._frame()
        self._made += 1
        self.resources.scan_count = self._made
        self.data.wait_for_client(0.5)
        if self.resources.gdp_enabled:
            self.data.publish(self._spoiled(self._messages(frame)))

    def _messages(self, frame: ScannerFrame) -> list[bytes]:
        """What the outputs ask for: stamp, surface, measurements, in the order of their ids; the last one marked."""
        modes, s = self.resources.group["scanModeSettings"], self.options
        time_s = frame.time_s if self._clock and frame.time_s else time.monotonic() - self._born
        index = 0 if self.faults.use("old_frame") else self._made
        parts: list[Part] = []
        for source, number in self._outputs():
            uniform = source == resources.UNIFORM
            if source == resources.LASER_PROFILE:
                parts.append((encode.UNIFORM_PROFILE, source, number, encode.profile(frame, self.resources.exposure_us)))
            elif source == resources.LASER_SURFACE:
                body = encode.surface(frame, True, modes["intensityEnabled"], self.resources.exposure_us, s.volume)
                parts.append((encode.UNIFORM_SURFACE, source, number, body))
            elif source == resources.TOOL:
                middle = encode.measurement(encode.middle_of_profile(frame))
                parts.append((encode.MEASUREMENT, source, number, middle))
            elif source in STAMPS:
                parts.append((encode.STAMP, source, number, encode.stamp(index, time_s)))
            elif uniform == bool(modes["uniformSpacingEnabled"]):
                body = encode.surface(frame, uniform, modes["intensityEnabled"], self.resources.exposure_us, s.volume)
                parts.append((encode.UNIFORM_SURFACE if uniform else encode.SURFACE_POINTS, source, number, body))
        for number, value in frame.measurements.items():
            parts.append((encode.MEASUREMENT, f"tools:Height-{number}:outputs:Z", 100 + number, encode.measurement(value)))
        return _packed(parts, self._made)

    def _outputs(self) -> list[tuple[str, int]]:
        """Source and id of what is sent, stamps first."""
        outputs = [(o["source"], o["outputId"]) for o in self.resources.outputs]
        return sorted(outputs, key=lambda o: (o[0] not in STAMPS, o[1]))

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


def _packed(parts: list[Part], set_id: int) -> list[bytes]:
    last = len(parts) - 1
    return [encode.message(k, encode.common(src, set_id, i == last, n), body) for i, (k, src, n, body) in enumerate(parts)]
