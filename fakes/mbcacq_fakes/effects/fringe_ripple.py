"""Fringes that are no perfect sines: a depth error with the fringes' period across the field."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments


class FringeRipple(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        self.period, self.phase = self.rng.uniform(22, 34), self.rng.uniform(-np.pi, np.pi)
        self.amplitude, self.axis = abs(self.size(0.06)), int(self.rng.integers(2))
        return {"where": ["scanner"], "depends_on": ["xy"[self.axis]], "period_mm": self.period, "amplitude_mm": self.amplitude}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        out = points.copy()
        out[:, 2] += self.amplitude * np.sin(2 * np.pi * points[:, self.axis] / self.period + self.phase)
        return out
