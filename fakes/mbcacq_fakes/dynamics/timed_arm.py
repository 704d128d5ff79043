"""An arm of any number of axes without masses: along jerk-limited motions in time, and published as it goes. rad, s."""

from __future__ import annotations

from typing import Any

import numpy as np
import ruckig

MOVED_RAD = 1e-9  # less is no motion


class TimedArm:
    """q, qd: (n,) rad, rad/s. time_s: its clock; still_s: since it stands, by that clock. target: (n,) of the last motion. state: gets what
    the arm does, or None; arrivals: how many motions it has ended already."""

    def __init__(self, q: np.ndarray, state: Any, clock_s: float, arrivals: int = 0) -> None:
        self.q, self.qd, self.target = np.array(q, dtype=float), np.zeros(len(q)), np.array(q, dtype=float)
        self.time_s, self.still_s, self._arrivals = clock_s, 0.0, arrivals
        self._direction, self._state, self._motion, self._since = np.zeros(len(q)), state, None, 0.0
        self.publish()

    @property
    def moving(self) -> bool:
        return self._motion is not None

    def go(self, target: np.ndarray, speed: Any, acceleration: Any, jerk: Any) -> None:
        """Begin a motion to ``target`` (n,); limits (n,), or one for all axes. Raises ValueError where it cannot be timed."""
        wanted = self._wanted()
        wanted.target_position = np.asarray(target, dtype=float).tolist()
        wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = map(self._each, (speed, acceleration, jerk))
        self._begin(wanted)
        self.target = np.array(target, dtype=float)

    def brake(self, acceleration: Any, jerk: Any) -> None:
        """Begin to bring all axes to rest, each as fast as it can."""
        wanted = self._wanted()
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.target_velocity = self._each(0.0)
        wanted.max_acceleration, wanted.max_jerk = map(self._each, (acceleration, jerk))
        self._begin(wanted)

    def advance(self, seconds: float, scale: float = 1.0) -> None:
        """Time goes on; the arm's own on its path by ``scale`` of it."""
        self.time_s += seconds
        if self._motion is None:
            self.still_s += seconds
        else:
            self._since = min(self._since + seconds * scale, self._motion.duration)
            position, speed, _ = self._motion.at_time(self._since)
            moved = np.array(position) - self.q
            self._direction = np.where(np.abs(moved) > MOVED_RAD, np.sign(moved), self._direction)
            self.q, self.qd = np.array(position), np.array(speed) * scale
            if self._since >= self._motion.duration:
                self.q, self.qd, self._motion = self.target.copy(), np.zeros(len(self.q)), None
                self._arrivals += 1
        self.publish()

    def publish(self) -> None:
        if self._state is not None:
            about = (tuple(v.tolist()) for v in (self.q, self.qd, self._direction))
            self._state.write(self.time_s, *about, self._motion is None, self._arrivals)

    def _each(self, value: Any) -> list[float]:
        return np.broadcast_to(np.asarray(value, dtype=float), self.q.shape).tolist()

    def _wanted(self) -> ruckig.InputParameter:
        wanted = ruckig.InputParameter(len(self.q))
        wanted.current_position, wanted.current_velocity = self.q.tolist(), self.qd.tolist()
        return wanted

    def _begin(self, wanted: ruckig.InputParameter) -> None:
        motion = ruckig.Trajectory(len(self.q))
        if ruckig.Ruckig(len(self.q)).calculate(wanted, motion) not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise ValueError("no motion within these limits")
        self._motion, self._since, self.still_s = motion, 0.0, 0.0
        self.target = np.array(motion.at_time(motion.duration)[0])
        self.publish()
