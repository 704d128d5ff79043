"""Grease that gives way slowly: after a short move a joint stops short, after a long one it does not."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class ShortMemory(InjectedEffect):
    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        self.lag, self.length = abs(self.size(4e-4 if self._axes[0] < 3 else 8e-4)), self.rng.uniform(0.15, 0.4)
        self._last: np.ndarray | None = None
        self._kept = np.zeros(self.cell.n)
        return {
            "where": self.names(self._axes),
            "depends_on": self.names(self._axes, "direction_"),
            "lag_rad": self.lag,
            "length_rad": self.length,
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        last = at.q[0].copy() if self._last is None and len(at) else self._last
        self._last = last
        if last is None:
            return
        for p in range(len(at)):
            for i in self._axes:
                travel = at.q[p, i] - last[i]
                if abs(travel) > 1e-4:
                    self._kept[i] = -self.lag * np.sign(travel) * np.exp(-abs(travel) / self.length)
                    last[i] = at.q[p, i]
                moved.joint[p, i] += self._kept[i]
