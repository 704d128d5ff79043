"""A link that grows as the arm warms up: a lumped heat balance, stepped through time."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class ThermalGrowth(InjectedEffect):
    """The link follows the arm's thermometer with a lag of ``lag_s`` (0: at once) and grows along its own length."""

    options = {"where": None, "growth_mm_per_K": None, "lag_s": 0.0}

    def draw(self) -> dict[str, Any]:
        step = np.diff(self.arm.zero[:, :3, 3], axis=0)
        length = np.linalg.norm(step, axis=1)
        self._axes = self.axes([i for i in range(self.cell.n) if length[i] > 200.0])
        i = self._axes[0]
        self._along = self.arm.zero[i + 1, :3, :3].T @ step[i] / length[i]
        given = self.given["growth_mm_per_K"]
        # A bare aluminium link of this length would grow by 23 ppm; castings and their drives by more, and unevenly.
        self.growth = abs(self.size(0.02)) if given is None else float(given)
        self._link_C, self._time, self._reference = 0.0, None, 0.0
        return {"where": self.names(self._axes, "link"), "growth_mm_per_K": self.growth, "lag_s": self.given["lag_s"]}

    def displace(self, at: Moments, moved: Moved) -> None:
        for p in range(len(at)):
            now, body = float(at.time_s[p]), float(at.robot_C[p])
            if self._time is None:
                self._link_C = self._reference = body
            elif now > self._time:
                share = -np.expm1(-(now - self._time) / self.given["lag_s"]) if self.given["lag_s"] > 0 else 1.0
                self._link_C += share * (body - self._link_C)
            self._time = now
            moved.frame[p, self._axes[0] + 1, :3] += self.growth * (self._link_C - self._reference) * self._along
