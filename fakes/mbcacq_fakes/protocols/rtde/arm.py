"""The arm behind the controller, driven as the program ``mbcacq_ur.script`` drives it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ruckig
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from mbcacq_fakes.dynamics.ideal_arm import Kinematics
from mbcacq_fakes.dynamics.timed_arm import TimedArm

JERK = 500.0  # rad/s^3
BRAKE = 8.0  # rad/s^2
LED_RAD_S = 1.0  # by a person, or by its own program
LINE_POINTS = 33
SLIDER_PER_S = 4.0  # how fast the speed follows the slider: from stop to full in a quarter of a second


class AlongPath:
    """A motion as of ruckig, along a path through joint angles q (k, 6) at lengths (k,)."""

    def __init__(self, length: np.ndarray, q: np.ndarray, speed: float, acceleration: float) -> None:
        wanted, self._along, self._path = ruckig.InputParameter(1), ruckig.Trajectory(1), CubicSpline(length, q)
        wanted.target_position, wanted.max_velocity, wanted.max_acceleration = [float(length[-1])], [speed], [acceleration]
        wanted.max_jerk = [JERK]
        ruckig.Ruckig(1).calculate(wanted, self._along)
        self.duration = self._along.duration

    def at_time(self, seconds: float) -> tuple[np.ndarray, np.ndarray, None]:
        (at,), (speed,), _ = self._along.at_time(seconds)
        return self._path(at), speed * self._path(at, 1), None


class ProgrammedArm(TimedArm):
    """taken: number of the command that was taken up. scale: of speed, as the slider has it. dh: rows, from which flange poses follow."""

    def __init__(self, start_deg: Sequence[float], state: Any, clock_s: float, dh: Sequence[Sequence[float]]) -> None:
        self.taken, self.scale, self._kinematics = 0, 1.0, Kinematics(dh)
        super().__init__(np.radians(np.array(start_deg, dtype=float)), state, clock_s)

    def obey(self, registers: Mapping[str, Any]) -> None:
        """The input registers as they are now."""
        if registers.get("input_int_register_0", self.taken) == self.taken:
            return
        self.taken = registers["input_int_register_0"]
        self.halt()
        if registers["input_int_register_1"] == 1:
            *target, speed, acceleration = (registers[f"input_double_register_{k}"] for k in range(8))
            self.go(np.array(target), speed, acceleration, JERK)

    def flange_pose(self, q: np.ndarray) -> list[float]:
        """x, y, z (m) and rotation vector (rad) of the flange, q (6,) rad."""
        x, y, z, *abc = self._kinematics.pose(np.degrees(q).tolist())
        return [1e-3 * x, 1e-3 * y, 1e-3 * z, *Rotation.from_euler("ZYX", abc, degrees=True).as_rotvec().tolist()]

    def joints_at(self, pose: np.ndarray, near: np.ndarray) -> np.ndarray:
        """(6,) rad: joint angles near ``near`` at a pose as of ``flange_pose``. Raises ValueError where the arm does not reach it."""
        wanted = Rotation.from_rotvec(pose[3:]).inv()

        def off(q: np.ndarray) -> np.ndarray:
            here = np.array(self.flange_pose(q))
            return np.r_[here[:3] - pose[:3], (wanted * Rotation.from_rotvec(here[3:])).as_rotvec()]

        found = least_squares(off, near, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(found.fun).max() > 1e-6:
            raise ValueError("no joint angles bring the flange to this pose")
        return found.x

    def line(self, pose: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (k,) m along a straight line from here to a pose, and joint angles (k, 6) rad there. Raises ValueError."""
        begin, end = np.array(self.flange_pose(self.q)), np.array(pose, dtype=float)
        share = np.linspace(0, 1, LINE_POINTS)
        turn = Slerp([0, 1], Rotation.from_rotvec([begin[3:], end[3:]]))(share).as_rotvec()
        q = [self.q]
        for one, rotation in zip(share[1:], turn[1:], strict=True):
            q.append(self.joints_at(np.r_[begin[:3] + one * (end[:3] - begin[:3]), rotation], q[-1]))
        return share * max(float(np.linalg.norm(end[:3] - begin[:3])), 1e-6), np.array(q)

    def lead(self, target: np.ndarray) -> None:
        """A person brings it to ``target`` (6,) rad."""
        self.halt()
        self.go(target, LED_RAD_S, BRAKE, JERK)

    def go_along(self, length: np.ndarray, q: np.ndarray, speed: float, acceleration: float) -> None:
        """Begin a motion through joint angles q (k, 6) rad at lengths (k,) of a path, with speed and acceleration along it."""
        self._motion, self._since, self.still_s = AlongPath(length, q, speed, acceleration), 0.0, 0.0
        self.target = q[-1].copy()

    def halt(self) -> None:
        """All axes to rest."""
        if not self.moving:
            return
        self.scale = 1.0  # brakes by the clock, whatever the slider says
        self.brake(BRAKE, JERK)
        while self.moving:
            super().advance(0.002)

    def advance(self, seconds: float, scale: float = 1.0) -> None:
        """scale: of the slider; the arm follows it along the path it is on."""
        step = SLIDER_PER_S * seconds
        self.scale += float(np.clip(scale - self.scale, -step, step)) if self.moving else scale - self.scale
        super().advance(seconds, self.scale)
