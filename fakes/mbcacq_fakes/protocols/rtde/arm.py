"""The arm behind the controller, driven as the program ``mbcacq_ur.script`` drives it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ruckig

JERK = 500.0  # rad/s^3
BRAKE = 8.0  # rad/s^2
LED_RAD_S = 1.0  # by a person, or by its own program
SLIDER_PER_S = 4.0  # how fast the speed follows the slider: from stop to full in a quarter of a second


class ProgrammedArm:
    """q, qd: (6,) rad, rad/s. taken: number of the command that was taken up. still_s: since it stands still, by its own clock. scale: of
    speed, as the slider has it. state: gets what the arm does, or None."""

    def __init__(self, start_deg: Sequence[float], state: Any, clock_s: float) -> None:
        self.q, self.qd, self.time_s, self.still_s = np.radians(np.array(start_deg, dtype=float)), np.zeros(6), clock_s, 0.0
        self.taken, self.scale, self._arrivals, self._direction = 0, 1.0, 0, np.zeros(6)
        self._state, self._motion, self._since = state, None, 0.0
        self.publish()

    @property
    def moving(self) -> bool:
        return self._motion is not None

    def obey(self, registers: Mapping[str, Any]) -> None:
        """The input registers as they are now."""
        if registers.get("input_int_register_0", self.taken) == self.taken:
            return
        self.taken = registers["input_int_register_0"]
        self.halt()
        if registers["input_int_register_1"] == 1:
            wanted = self._wanted()
            wanted.target_position = [registers[f"input_double_register_{k}"] for k in range(6)]
            wanted.max_velocity = [registers["input_double_register_6"]] * 6
            wanted.max_acceleration, wanted.max_jerk = [registers["input_double_register_7"]] * 6, [JERK] * 6
            self._begin(wanted)

    def lead(self, target: np.ndarray) -> None:
        """A person brings it to ``target`` (6,) rad."""
        self.halt()
        wanted = self._wanted()
        wanted.target_position, wanted.max_velocity = target.tolist(), [LED_RAD_S] * 6
        wanted.max_acceleration, wanted.max_jerk = [BRAKE] * 6, [JERK] * 6
        self._begin(wanted)

    def halt(self) -> None:
        """All axes to rest."""
        if self._motion is None:
            return
        wanted, self.scale = self._wanted(), 1.0  # brakes by the clock, whatever the slider says
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.target_velocity, wanted.max_acceleration, wanted.max_jerk = [0.0] * 6, [BRAKE] * 6, [JERK] * 6
        self._begin(wanted)
        while self._motion is not None:
            self.advance(0.002)

    def advance(self, seconds: float, speed_fraction: float = 1.0) -> None:
        """Time goes on. speed_fraction: of the slider; the arm follows it along the path it is on."""
        self.time_s += seconds
        self.still_s = 0.0 if self.moving else self.still_s + seconds
        step = SLIDER_PER_S * seconds
        self.scale += float(np.clip(speed_fraction - self.scale, -step, step)) if self.moving else speed_fraction - self.scale
        if self._motion is not None:
            self._since = min(self._since + seconds * self.scale, self._motion.duration)
            position, speed, _ = self._motion.at_time(self._since)
            turned = np.array(position) - self.q
            self._direction = np.where(np.abs(turned) > 1e-9, np.sign(turned), self._direction)
            self.q, self.qd = np.array(position), np.array(speed) * self.scale
            if self._since >= self._motion.duration:
                self._motion, self.qd = None, np.zeros(6)
                self._arrivals += 1
        self.publish()

    def publish(self) -> None:
        if self._state is not None:
            about = (tuple(v.tolist()) for v in (self.q, self.qd, self._direction))
            self._state.write(self.time_s, *about, self._motion is None, self._arrivals)

    def _wanted(self) -> ruckig.InputParameter:
        wanted = ruckig.InputParameter(6)
        wanted.current_position, wanted.current_velocity = self.q.tolist(), self.qd.tolist()
        return wanted

    def _begin(self, wanted: ruckig.InputParameter) -> None:
        motion = ruckig.Trajectory(6)
        if ruckig.Ruckig(6).calculate(wanted, motion) not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise ValueError("no motion within these limits")  # as a controller ends its program
        self._motion, self._since = motion, 0.0
