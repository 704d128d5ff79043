"""An anchor bolt that has come loose: the pedestal tips over when the arm leans to that side, and stands firm otherwise."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.arm import STANDARD_GRAVITY
from mbcacq_fakes.world.hooks import Moments, Moved


class LooseAnchor(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        side = self.rng.uniform(-0.35, 0.35)  # the arm works to its front; a bolt at its back would never lift
        self.axis = np.array([-np.sin(side), np.cos(side), 0.0])
        self.gap = abs(self.size(2.5e-4))
        planned = self.cell.planned_q
        usual = self._moment(np.zeros((1, self.cell.n)) if planned is None or not len(planned) else planned)
        # It lifts somewhere in the middle of what the arm does.
        self._level = float(np.quantile(usual, self.rng.uniform(0.35, 0.65)))
        self._soft = 0.3 * float(np.std(usual)) or 0.05 * abs(self._level)
        return {"where": ["base"], "depends_on": ["gravity"], "gap_rad": self.gap}

    def _moment(self, q: np.ndarray) -> np.ndarray:
        """(P,) N m that tips the pedestal over to that side."""
        centres, mass = self.cell.masses.weights(self.arm, q)
        return np.cross(centres, STANDARD_GRAVITY * mass[:, None] * self.cell.masses.gravity).sum(axis=1) @ self.axis * 1e-3

    def displace(self, at: Moments, moved: Moved) -> None:
        tipped = 0.5 * (1 + np.tanh((self._moment(at.q) - self._level) / self._soft))
        moved.frame[:, 0, 3:] += (self.gap * tipped)[:, None] * self.axis
