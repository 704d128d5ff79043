"""A fake sensor as a line scanner: a profile at every moment of its own clock, as long as it runs."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Protocol

import numpy as np

_POLL_S = 0.01
_MOST = 200  # profiles that are made at once
PATIENCE_S = 10.0  # with a client that reads slowly
_log = logging.getLogger("mbcacq.fakes.profiles")


@dataclass(frozen=True, kw_only=True)
class LineSensorOptions:
    """profiles: the jobs are those of a line scanner, triggered ``frame_rate_hz`` times a second. Its clock began ``clock_began_s`` after
    the world's and runs faster by ``clock_drift``; its stamps scatter by ``stamp_jitter_s``. A share of ``lost_profiles`` is counted and
    never sent."""

    profiles: bool = False
    frame_rate_hz: float = 0.0
    clock_began_s: float = 0.0
    clock_drift: float = 0.0
    stamp_jitter_s: float = 0.0
    lost_profiles: float = 0.0


class LineSource(Protocol):
    """What a laser plane meets in the world."""

    def now(self) -> float:
        """The world's clock, s, up to which profiles can be taken."""
        ...

    def profiles(self, times: np.ndarray) -> list[np.ndarray]:
        """(W, 2) mm x and z of the laser line at each of these times, NaN where nothing was measured."""
        ...


class LineSensor(Protocol):
    """The sensor whose profiles are sent."""

    closing: threading.Event

    @property
    def options(self) -> LineSensorOptions: ...

    def profile_period_s(self) -> float | None:
        """Between two profiles; None while the sensor is at rest."""
        ...

    def restarts(self) -> bool:
        """Whether its counter and clock begin anew now."""
        ...

    def send_profile(self, index: int, own_s: float, profile: np.ndarray) -> None:
        """Send one profile (W, 2) mm, taken at a time of the sensor's clock, to every client."""
        ...


class ProfileSender:
    """``catch_up`` makes and sends all profiles up to now; ``run`` calls it until the sensor closes."""

    def __init__(self, sensor: LineSensor, line: LineSource, seed: int) -> None:
        self._sensor, self._line = sensor, line
        self._one = threading.Lock()
        self._next_s: float | None = None
        self._counter, self._began_s = 0, sensor.options.clock_began_s
        self._rng = np.random.default_rng(seed)

    def run(self) -> None:
        while not self._sensor.closing.wait(_POLL_S):
            self.catch_up()

    def catch_up(self) -> None:
        """Nothing where the sensor does not run. Never raises."""
        with self._one:
            period = self._sensor.profile_period_s()
            if period is None:
                self._next_s = None
                return
            try:
                now = self._line.now()
                if self._next_s is None:
                    self._next_s = now
                while self._next_s <= now and not self._sensor.closing.is_set():
                    times = np.arange(self._next_s, now + 1e-9, period)[:_MOST]
                    for time_s, profile in zip(times, self._line.profiles(times), strict=True):
                        self._take(float(time_s), profile)
                    self._next_s = float(times[-1] + period)
            except Exception:
                _log.exception("the profiles failed; no more are sent")
                self._next_s = np.inf

    def _take(self, time_s: float, profile: np.ndarray) -> None:
        options = self._sensor.options
        if self._sensor.restarts():
            self._counter, self._began_s = 0, time_s
        own_s = (time_s - self._began_s) * (1 + options.clock_drift) + options.stamp_jitter_s * self._rng.standard_normal()
        index, self._counter = self._counter, self._counter + 1
        if self._rng.random() >= options.lost_profiles:
            self._sensor.send_profile(index, own_s, profile)
