"""A camera that creeps in its bracket: the measured depth tilts over across the field, a little more every hour."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments


class TiltingCamera(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        self.axis = int(self.rng.integers(2))
        self.creep = self.size(3e-3)  # rad in an hour
        return {"where": ["scanner"], "depends_on": ["time", "xy"[self.axis]], "creep_rad_per_h": self.creep}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        out = points.copy()
        out[:, 2] += self.creep * at.time_s[pose] / 3600 * points[:, self.axis]
        return out
