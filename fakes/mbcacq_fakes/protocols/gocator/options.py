"""What a fake Gocator is before it starts: addresses, model, firmware, and the jobs and settings it serves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbcacq_fakes.protocols.line_sensor import LineSensorOptions

DISCOVERY_PORT = 3220


class Ports(NamedTuple):
    """TCP ports of the three channels."""

    control: int
    health: int
    data: int


@dataclass(frozen=True, kw_only=True)
class FakeGocatorOptions(LineSensorOptions):
    """A port of 0 is any free one. discovery: answer on udp ``discovery_port`` with replies sent to ``broadcast``.

    scan_time_s: duration of an exposure. generation: 4, 5 or 6, the firmware whose message layouts are used. intensity, uniform: what the
    jobs switch on. clock: the world's time in s; with it ``ScannerFrame.time_s`` becomes the stamp, without it the sensor counts from its
    start. volume: (low, high) (3,) mm of the measuring volume, None for the extent of each frame. frame_rate_hz: 0 for jobs triggered by
    software, else they are triggered by time. password: '' with security off, else what the administrator logs in with. The others: see
    LineSensorOptions.
    """

    host: str = "127.0.0.1"
    control_port: int = 0
    health_port: int = 0
    data_port: int = 0
    discovery: bool = False
    discovery_port: int = DISCOVERY_PORT
    broadcast: str = "255.255.255.255"
    model: str = "3210"
    serial: int = 12345
    scan_time_s: float = 0.0
    jobs: tuple[str, ...] = ("bench.job", "other.job")
    generation: int = 6
    intensity: bool = True
    uniform: bool = False
    clock: Callable[[], float] | None = None
    volume: tuple[np.ndarray, np.ndarray] | None = None
    health_period_s: float = 1.0
    password: str = ""
