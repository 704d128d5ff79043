"""The arm behind the controller, driven as the program ``mbcacq_ur.script`` drives it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq_fakes.dynamics.timed_arm import TimedArm

JERK = 500.0  # rad/s^3
BRAKE = 8.0  # rad/s^2
LED_RAD_S = 1.0  # by a person, or by its own program
SLIDER_PER_S = 4.0  # how fast the speed follows the slider: from stop to full in a quarter of a second


class ProgrammedArm(TimedArm):
    """taken: number of the command that was taken up. scale: of speed, as the slider has it."""

    def __init__(self, start_deg: Sequence[float], state: Any, clock_s: float) -> None:
        self.taken, self.scale = 0, 1.0
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

    def lead(self, target: np.ndarray) -> None:
        """A person brings it to ``target`` (6,) rad."""
        self.halt()
        self.go(target, LED_RAD_S, BRAKE, JERK)

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
