"""A pedestal that tilts until its elasticity balances the overturning moment of everything above it."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.arm import STANDARD_GRAVITY
from mbcacq_fakes.world.hooks import Moments, Moved
from mbcacq_fakes.world.rigid import carry, rigid, rotation_about


class BaseCompliance(InjectedEffect):
    options = {"compliance_rad_per_Nm": None}

    def draw(self) -> dict[str, Any]:
        given = self.given["compliance_rad_per_Nm"]
        moment = float(np.linalg.norm(self._moment(np.zeros((1, self.cell.n)), np.zeros((1, 3)))))
        self.compliance = abs(self.size(2e-4 / max(moment, 1.0))) if given is None else float(given)
        return {"where": ["base"], "compliance_rad_per_Nm": self.compliance}

    def _moment(self, q: np.ndarray, tilt: np.ndarray) -> np.ndarray:
        """(P, 3) N m about the base origin, of an arm already tilted by rotation vectors (P, 3)."""
        centres, mass = self.cell.masses.weights(self.arm, q)
        angle = np.linalg.norm(tilt, axis=1)
        T = rigid(rotation_about(tilt / np.where(angle > 0, angle, 1)[:, None], angle), np.zeros(3))
        force = STANDARD_GRAVITY * mass[:, None] * self.cell.masses.gravity
        return np.cross(carry(T, centres), force).sum(axis=1) * 1e-3

    def displace(self, at: Moments, moved: Moved) -> None:
        tilt = np.zeros((len(at), 3))
        for _ in range(3):
            tilt = self.compliance * self._moment(at.q, tilt)
        moved.frame[:, 0, 3:] += tilt
