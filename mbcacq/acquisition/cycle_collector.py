"""Collects the robot's raw cycles all the time, also while a scan is being taken."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.events import CyclesReceived
from mbcacq.devices import Cycles, Robot

REGULAR = 0.9  # share of equal steps that makes a fixed rate
PERIOD_S = 0.04  # keeps the loss at a power cut well below 0.1 s


class CycleCollector:
    """A thread that turns ``robot.cycles()`` into events. ``mark`` and ``since_mark`` give the cycles of a time span."""

    def __init__(self, robot: Robot, bus: EventBus, look: Callable[[], None] = lambda: None) -> None:
        """look: called as often as cycles are collected."""
        self._look = look
        self._robot, self._bus = robot, bus
        self._span: list[Cycles] = []
        self._lock = threading.Lock()
        self._quit = threading.Event()
        self._error: BaseException | None = None
        self.count = 0
        self._delay = [np.nan, np.nan]  # the controller's counter of late answers, first and last value
        self._last_time = np.nan
        self._steps: list[np.ndarray] = []  # robot time between neighbouring cycles
        self._thread = threading.Thread(target=self._work, name="cycle-collector", daemon=True)

    def __enter__(self) -> CycleCollector:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._quit.set()
        self._thread.join()
        if self._error is None:
            self.drain()

    def check(self) -> None:
        """Raise here what a subscriber raised in the collector's thread."""
        if self._error is not None:
            raise self._error

    def drain(self) -> None:
        """Take the cycles that have come since the last call, and emit them."""
        with self._lock:
            cycles = self._robot.cycles()
            if len(cycles):
                self._span.append(cycles)
                self.count += len(cycles)
                times = np.concatenate([[self._last_time], cycles.columns["time_s"]])
                self._steps.append(np.diff(times))
                self._last_time = times[-1]
                delay = cycles.columns.get("delay")
                if delay is not None:
                    self._delay = [delay[0] if np.isnan(self._delay[0]) else self._delay[0], delay[-1]]
                self._bus.emit(CyclesReceived, cycles)

    @property
    def late(self) -> int | None:
        """Answers that the controller counted as late, if it counts them."""
        return None if np.isnan(self._delay[0]) else int(self._delay[1] - self._delay[0])

    @property
    def missing(self) -> int:
        """Cycles that the robot's clock says there were and that never came; 0 where the robot reports at no fixed rate."""
        steps = np.concatenate(self._steps) if self._steps else np.zeros(0)
        steps = steps[np.isfinite(steps)]
        period = float(np.median(steps)) if len(steps) else 0.0
        if period <= 0 or np.mean(np.abs(steps - period) < 0.1 * period) < REGULAR:
            return 0
        return int(np.sum(np.rint(steps[steps > 1.5 * period] / period) - 1))

    def mark(self) -> None:
        """Forget the cycles so far: a new span begins."""
        self.drain()
        with self._lock:
            self._span.clear()

    def since_mark(self) -> dict[str, np.ndarray]:
        """Columns of all cycles since ``mark``; empty if none came."""
        self.drain()
        with self._lock:
            spans = [s.columns for s in self._span]
        return {name: np.concatenate([s[name] for s in spans]) for name in spans[0]} if spans else {}

    def _work(self) -> None:
        try:
            while not self._quit.wait(PERIOD_S):
                self.drain()
                self._look()
        except BaseException as error:
            self._error = error
