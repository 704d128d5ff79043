"""The head that reads an encoder sits at the end of a bracket, which grows as the arm warms up and carries the head along the disc."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved

ALUMINIUM = 23.6e-6  # growth a kelvin, relative
DISC_MM = 15.0  # radius at which the lines are read


class ThermalZeroShift(InjectedEffect):
    options = {"where": None, "bracket_mm": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        given = self.given["bracket_mm"]
        self.bracket_mm = self.size(12.0) if given is None else float(given)
        self._cold: float | None = None
        return {"where": self.names(self._axes), "depends_on": "robot_C", "zero_rad_per_K": self.bracket_mm * ALUMINIUM / DISC_MM}

    def displace(self, at: Moments, moved: Moved) -> None:
        if self._cold is None:
            self._cold = float(at.robot_C[0])
        grown = self.bracket_mm * ALUMINIUM * (at.robot_C - self._cold)
        moved.joint[:, self._axes[0]] += np.arctan2(grown, DISC_MM)
