"""Friction in a loaded gearbox: where the output comes to rest lies between two edges, which are the wider apart the larger the load."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class Hysteresis(InjectedEffect):
    options = {"where": None, "half_width_rad_per_Nm": None}

    def draw(self) -> dict[str, Any]:
        loaded = [i for i in (1, 2) if i < self.cell.n]
        self._axes = self.axes(loaded)
        reach = float(np.abs(self.cell.masses.torque(self.arm, np.zeros((1, self.cell.n)))).max())
        given = self.given["half_width_rad_per_Nm"]
        self.half = abs(self.size(2e-4)) / max(reach, 1.0) if given is None else float(given)
        return {"where": self.names(self._axes), "half_width_rad_per_Nm": self.half}

    def displace(self, at: Moments, moved: Moved) -> None:
        """The output follows the motor until friction, a share of the load, holds it: dragged from the side it came from."""
        torque = self.cell.masses.torque(self.arm, at.q)
        for i in self._axes:
            half = self.half * np.abs(torque[:, i])
            for p in range(len(at)):
                motor, rest = at.q[p, i], at.q[p, i]
                for angle in (motor - at.direction[p, i] * 3 * half[p], motor):
                    rest = float(np.clip(rest, angle - half[p], angle + half[p]))
                moved.joint[p, i] += rest - motor
