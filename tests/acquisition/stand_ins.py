"""Devices without a wire, for tests of the runner alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.devices import Cycles, Description, DeviceFault, MotionLimits, RobotState, Scan


class StandIn:
    def __init__(self) -> None:
        self.log: list[str] = []

    def connect(self) -> None:
        self.log.append("connect")

    def describe(self) -> Description:
        return Description(type(self).__name__, "stand-in", ())

    def stop(self) -> None:
        self.log.append("stop")

    def close(self) -> None:
        self.log.append("close")

    def __enter__(self):
        self.connect()
        return self

    def __exit__(self, *_):
        self.close()


class JumpingRobot(StandIn):
    """Arrives at once; every call to ``state`` is one controller cycle."""

    def __init__(self) -> None:
        super().__init__()
        self.q, self.time, self.rows = np.zeros(6), 0.0, []
        self.targets: list[np.ndarray] = []
        self.fault: Exception | None = None
        self.arrives = True

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        self.targets.append(q)
        self.log.append("move")
        if self.arrives:
            self.q = q

    def state(self) -> RobotState:
        if self.fault is not None:
            raise self.fault
        self.time += 0.5
        self.rows.append((self.time, self.q))
        return RobotState(self.time, self.q, not self.arrives, self.arrives)

    def cycles(self) -> Cycles:
        rows, self.rows = self.rows, []
        if not rows:
            return Cycles({})
        time, q = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
        return Cycles({"time_s": time, "host_time_s": time, "q": q, "q_set": q, "q_command": q})


class StillScanner(StandIn):
    def __init__(self) -> None:
        super().__init__()
        self.fault: Exception | None = None

    def capture(self, exposure_us: float | None = None) -> Scan:
        if self.fault is not None:
            raise self.fault
        return Scan(points=np.zeros((4, 3), np.float32))


class Placer(StandIn):
    def go_to(self, station: str, prompt: str) -> None:
        self.log.append(f"station {station}")


@dataclass
class Found:
    ball: np.ndarray
    xyz: np.ndarray
    n_points: np.ndarray = field(init=False)
    rms_mm: np.ndarray = field(init=False)
    covariance: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.n_points = np.full(len(self.ball), 100)
        self.rms_mm = np.full(len(self.ball), 0.01)
        self.covariance = np.tile(1e-6 * np.eye(3), (len(self.ball), 1, 1))


class Finder:
    """Sees the expected balls at their predicted places, shifted a little more at every exposure."""

    def __init__(self) -> None:
        self.calls, self.seen = 0, None

    def __call__(self, points, artefact, *, expected, predicted) -> Found:
        self.calls += 1
        seen = len(expected) if self.seen is None else self.seen
        if seen < 0:
            raise DeviceFault("wrong artefact in view: distances fit no certificate; put the right one there")
        return Found(np.array(expected[:seen], int), predicted[:seen] + 0.01 * self.calls)
