"""The fake as a line scanner: a profile at every moment of its own clock, as long as it runs."""

from __future__ import annotations

import logging
import threading
from typing import Protocol

import numpy as np

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.data_faults import apply_fault
from mbcacq_fakes.protocols.gocator.files import EXPOSURE
from mbcacq_fakes.protocols.gocator.quantise import Scaling
from mbcacq_fakes.protocols.gocator.state import TICKS_PER_S, SensorState

_POLL_S = 0.01
_PATIENCE_S = 10.0  # with a client that reads slowly
_MOST = 200  # profiles that are made at once
_log = logging.getLogger("mbcacq.fakes.gocator")


class LineSource(Protocol):
    """What a laser plane meets in the world."""

    def now(self) -> float:
        """The world's clock, s, up to which profiles can be taken."""
        ...

    def profiles(self, times: np.ndarray) -> list[np.ndarray]:
        """(W, 2) mm x and z of the laser line at each of these times, NaN where nothing was measured."""
        ...


class ProfileSender:
    """``catch_up`` makes and sends all profiles up to now; ``run`` calls it until the sensor closes."""

    def __init__(self, state: SensorState, line: LineSource) -> None:
        self._state, self._line = state, line
        self._one = threading.Lock()
        self._next_s: float | None = None
        self._counter, self._began_s = 0, state.options.clock_began_s
        self._rng = np.random.default_rng(state.serial)

    def run(self) -> None:
        while not self._state.closing.wait(_POLL_S):
            self.catch_up()

    def catch_up(self) -> None:
        """Nothing where the sensor does not run. Never raises."""
        with self._one:
            if not self._state.running:
                self._next_s = None
                return
            try:
                now = self._line.now()
                period = 1 / max(self._state.files.number("Setup/Trigger/FrameRate"), 1e-3)
                if self._next_s is None:
                    self._next_s = now
                while self._next_s <= now and not self._state.closing.is_set():
                    times = np.arange(self._next_s, now + 1e-9, period)[:_MOST]
                    for time_s, profile in zip(times, self._line.profiles(times), strict=True):
                        self._send(float(time_s), profile)
                    self._next_s = float(times[-1] + period)
            except Exception:
                _log.exception("the profiles failed; no more are sent")
                self._next_s = np.inf

    def _send(self, time_s: float, profile: np.ndarray) -> None:
        state, options = self._state, self._state.options
        if state.faults.use("restart"):
            self._counter, self._began_s = 0, time_s
        own_s = (time_s - self._began_s) * (1 + options.clock_drift) + options.stamp_jitter_s * self._rng.standard_normal()
        index, self._counter = self._counter, self._counter + 1
        if self._rng.random() < options.lost_profiles:
            return
        low, high = options.volume or (np.array([-100.0, 0.0, -100.0]), np.array([100.0, 0.0, 100.0]))
        exposure_ns = int(round(state.files.number(EXPOSURE) * 1000))
        body = encode.profile_points(profile[None], Scaling.over(low, high), exposure_ns, state.generation)
        stamp = encode.stamp(index, max(int(own_s * TICKS_PER_S), 0), state.encoder, state.serial, state.generation)
        messages = apply_fault([stamp, encode.mark_last(body)], state.faults)
        state.data.wait_for_client(0.5)
        state.data.publish(messages, _PATIENCE_S)
