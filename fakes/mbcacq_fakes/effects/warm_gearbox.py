"""A gearbox that gets softer as it gets warmer: its wind-up under the arm's weight grows through the shift."""

from __future__ import annotations

from typing import Any

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class WarmGearbox(InjectedEffect):
    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes([i for i in (1, 2) if i < self.cell.n])
        self.softening = abs(self.size(2e-7))
        self._first: float | None = None
        return {
            "where": self.names(self._axes),
            "depends_on": [f"gravity_torque_{i + 1}" for i in self._axes] + ["robot_C", "time"],
            "softening_rad_per_Nm_K": self.softening,
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        if self._first is None:
            self._first = float(at.robot_C[0])
        torque = self.cell.masses.torque(self.arm, at.q)
        for i in self._axes:
            moved.joint[:, i] += self.softening * (at.robot_C - self._first) * torque[:, i]
