"""A floor that follows the air: the pedestal leans and rises with the hall's temperature, the tripods do not."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class FloorHeave(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        self.rise, self.lean = self.vector(0.12), np.append(self.vector(1.5e-4, 2), 0.0)
        self._first: float | None = None
        return {
            "where": ["base"],
            "depends_on": ["air_C", "time"],
            "rise_mm_per_K": self.rise.tolist(),
            "lean_rad_per_K": self.lean.tolist(),
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        if self._first is None:
            self._first = float(at.air_C[0])
        warmer = (at.air_C - self._first)[:, None]
        moved.frame[:, 0] += np.concatenate([warmer * self.rise, warmer * self.lean], axis=1)
