"""The state that the parts of the fake sensor share: settings, files, faults, clock, exposure requests and clients."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

import numpy as np

from mbcacq_fakes.protocols.datagrams import facing
from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.data_faults import apply_fault
from mbcacq_fakes.protocols.gocator.faults import FAULTS
from mbcacq_fakes.protocols.gocator.files import EXPOSURE, Files
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.publish import Publisher
from mbcacq_fakes.protocols.gocator.quantise import Scaling
from mbcacq_fakes.protocols.line_sensor import PATIENCE_S
from mbcacq_fakes.protocols.tcp_server import ClientThreads

TICKS_PER_S = 1.024e6
_MAX_REQUESTS = 16
_FIRMWARE = {4: (4, 8, 2, 29), 5: (5, 3, 23, 10), 6: (6, 1, 32, 12)}
_PROTOCOL = {4: (101, 4), 5: (101, 10), 6: (101, 11)}


class SensorState:
    """Starts no thread and opens no port. ``requests`` holds the ticks at which exposures were asked for; ``lock`` guards ``running``
    and ``operations``. indicators: health values sent besides the usual ones, by (number, instance)."""

    def __init__(self, options: FakeGocatorOptions) -> None:
        self.options = options
        self.firmware, self.protocol = _FIRMWARE[options.generation], _PROTOCOL[options.generation]
        switches: dict[str, float] = {"Setup/IntensityEnabled": options.intensity, "Setup/UniformSpacingEnabled": options.uniform}
        if options.frame_rate_hz:
            switches |= {"Setup/Trigger/Source": 0, "Setup/Trigger/FrameRate": options.frame_rate_hz}
        if options.profiles:
            switches["Setup/ScanMode"] = 2
        self.files, self.faults = Files(tuple(options.jobs), switches), Faults(FAULTS)
        self.settings = {"alignment_state": 0, "login": 0}
        self.encoder, self.temperature_C = 0, 41.0
        self.indicators: dict[tuple[int, int], int] = {}
        self.running, self.operations, self.exposures = False, 0, 0
        self.catch_up: Callable[[], None] = lambda: None  # what a stop waits for: profiles of the time before it
        self.requests: queue.Queue[int] = queue.Queue(_MAX_REQUESTS)
        self.data, self.health, self.control = Publisher(), Publisher(), ClientThreads()
        self.lock, self.closing = threading.Lock(), threading.Event()
        self._born = time.monotonic()

    @property
    def serial(self) -> int:
        return self.options.serial

    @property
    def generation(self) -> int:
        return self.options.generation

    @property
    def model(self) -> str:
        return self.faults.get("model") or self.options.model

    @property
    def part_number(self) -> str:
        return f"31{self.model}A-2-R-01-T"

    @property
    def address(self) -> str:
        return self.options.host if self.options.host not in ("", "0.0.0.0") else facing(("192.0.2.1", 9)) or "127.0.0.1"

    @property
    def uptime_s(self) -> float:
        return time.monotonic() - self._born

    def ticks(self) -> int:
        """The sensor's clock in the unit of time stamps."""
        clock = self.options.clock
        return int((clock() if clock else self.uptime_s) * TICKS_PER_S)

    def profile_period_s(self) -> float | None:
        return 1 / max(self.files.number("Setup/Trigger/FrameRate"), 1e-3) if self.running else None

    def restarts(self) -> bool:
        return bool(self.faults.use("restart"))

    def send_profile(self, index: int, own_s: float, profile: np.ndarray) -> None:
        low, high = self.options.volume or (np.array([-100.0, 0.0, -100.0]), np.array([100.0, 0.0, 100.0]))
        exposure_ns = int(round(self.files.number(EXPOSURE) * 1000))
        body = encode.profile_points(profile[None], Scaling.over(low, high), exposure_ns, self.generation)
        stamp = encode.stamp(index, max(int(own_s * TICKS_PER_S), 0), self.encoder, self.serial, self.generation)
        messages = apply_fault([stamp, encode.mark_last(body)], self.faults)
        if not index:
            self.data.wait_for_client(0.5)
        self.data.publish(messages, PATIENCE_S)

    def drop_connections(self) -> None:
        """Close every connection of every client; new ones are accepted."""
        self.control.shut_down()
        self.data.close()
        self.health.close()
