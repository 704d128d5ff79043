"""A controller that believes in a wrong gear ratio."""

from __future__ import annotations

from typing import Any

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class JointScale(InjectedEffect):
    options = {"where": None, "ratio": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        typical = 3e-4 if self._axes[0] < 3 else 4e-4
        self.ratio = self.size(typical) if self.given["ratio"] is None else float(self.given["ratio"])
        return {"where": self.names(self._axes), "ratio": self.ratio}

    def displace(self, at: Moments, moved: Moved) -> None:
        for i in self._axes:
            teeth = self.cell.gear_ratio[i]
            motor = at.q[:, i] * teeth
            moved.joint[:, i] += motor / (teeth / (1 + self.ratio)) - at.q[:, i]
