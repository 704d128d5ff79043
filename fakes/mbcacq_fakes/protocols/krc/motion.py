"""PTP of the fake controller: all axes together along one path, trapezoidal, braking on the path. deg, mm, s."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np

from mbcacq_fakes.world.rigid import invert, rigid, rotation_about

_RAMP_S = 0.3  # to an axis' largest speed at 100 % acceleration


def frame(values: Sequence[float]) -> np.ndarray:
    """X, Y, Z, A, B, C (mm, deg) -> (4, 4); R = Rz(A) Ry(B) Rx(C)."""
    return rigid(np.linalg.multi_dot(rotation_about(np.eye(3)[::-1], np.radians(values[3:]))), np.array(values[:3], dtype=float))


def angles(T: np.ndarray) -> tuple[float, ...]:
    """(4, 4) -> X, Y, Z, A, B, C."""
    R = T[:3, :3]
    turned = np.degrees([np.arctan2(R[1, 0], R[0, 0]), np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])), np.arctan2(R[2, 1], R[2, 2])])
    return (*T[:3, 3].tolist(), *turned.tolist())


class Path:
    """A path of unit length: ``at(s)`` gives the joints (6,) deg, speed and acceleration count in paths per second."""

    def __init__(self, at: Callable[[float], tuple[float, ...]], speed: float, acceleration: float) -> None:
        self._at, self._speed, self._acceleration = at, speed, acceleration
        self._s = self._v = 0.0
        self._braking = self.done = False

    def brake(self) -> None:
        self._braking = True

    def step(self, dt: float, override: float) -> tuple[float, ...]:
        """The next set point."""
        left, most = 1.0 - self._s, self._acceleration * dt
        if self._braking:
            wanted = 0.0
        else:
            wanted = min(self._speed * override, sqrt(2.0 * self._acceleration * left + 0.25 * most * most) - 0.5 * most)
        self._v = max(min(wanted, self._v + most), self._v - most, 0.0)
        self._s += self._v * dt
        if self._s >= 1.0 - 1e-9 or (not self._braking and left < 2.0 * most * dt):
            self._s, self.done = 1.0, True
        elif self._braking and self._v <= 0.0:
            self.done = True
        return self._at(self._s)


def ptp(
    start: Sequence[float], target: Sequence[float], speed: Sequence[float], percent: tuple[Sequence[float], Sequence[float]]
) -> Path | None:
    """All axes start and stop together. speed: (6,) deg/s at 100 %. percent: of speed and of acceleration, per axis.
    None: the arm is there already.
    """
    a = np.asarray(start, dtype=float)
    travel = np.asarray(target, dtype=float) - a
    far = np.abs(travel)
    if far.max() < 1e-9:
        return None
    moving, most = far > 1e-9, np.asarray(speed) / 100.0
    fast, steep = most * np.asarray(percent[0]) / np.maximum(far, 1e-9), most / _RAMP_S * np.asarray(percent[1]) / np.maximum(far, 1e-9)
    return Path(lambda s: tuple((a + s * travel).tolist()), float(np.min(fast[moving])), float(np.min(steep[moving])))


def tool_in_base(flange: np.ndarray, tool: np.ndarray, base: np.ndarray, robroot: np.ndarray) -> np.ndarray:
    """$POS_ACT: the tool in the active base, both in the world in which $ROBROOT stands."""
    return invert(base) @ robroot @ flange @ tool
