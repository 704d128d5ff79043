"""Gearboxes wind up until their torsion balances gravity: the static equilibrium of elastic joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved

TYPICAL = np.array([0.5, 1.2, 1.7, 6.0, 8.0, 12.0]) * 1e-6  # rad / N m, softer towards the wrist


class JointCompliance(InjectedEffect):
    options = {"where": None, "compliance_rad_per_Nm": None}

    def draw(self) -> dict[str, Any]:
        loaded = [i for i in (1, 2) if i < self.cell.n]
        self._axes = self.axes(loaded, most=len(loaded))
        given = self.given["compliance_rad_per_Nm"]
        self.compliance = np.zeros(self.cell.n)
        for i in self._axes:
            typical = TYPICAL[min(i, 5)] * self._softness()
            self.compliance[i] = abs(self.size(typical)) if given is None else float(given)
        return {
            "where": self.names(self._axes),
            "compliance_rad_per_Nm": {self.cell.axes[i]: float(self.compliance[i]) for i in self._axes},
        }

    def _softness(self) -> float:
        """A light arm carries little and is built soft: the same deflection under its own outstretched weight."""
        reach = self.cell.masses.torque(self.arm, np.zeros((1, self.cell.n)))[0]
        return float(np.clip(250.0 / max(np.abs(reach).max(), 1.0), 0.05, 20.0))

    def displace(self, at: Moments, moved: Moved) -> None:
        commanded, wound = at.q + moved.joint, at.q + moved.joint
        for _ in range(4):  # the torque changes little over a wind-up of a milliradian: a contraction
            wound = commanded + self.compliance * self.cell.masses.torque(self.arm, wound)
        moved.joint += wound - commanded
