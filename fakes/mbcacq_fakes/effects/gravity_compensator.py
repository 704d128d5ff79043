"""A balancer at A2: a rod from a point of the carousel to one of the link pulls with a force that grows as it gets longer."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class GravityCompensator(InjectedEffect):
    """Its torque about A2, force times lever of two points in a plane, winds the gearbox up beside the arm's weight."""

    options = {"compliance_rad_per_Nm": None, "share": None, "lever_ratio": None}

    def draw(self) -> dict[str, Any]:
        q = np.zeros((361, self.cell.n))
        q[:, 1] = np.linspace(-np.pi, np.pi, 361)
        weight = self.cell.masses.torque(self.arm, q)[:, 1]
        self._upright = float(q[np.argmin(np.abs(weight) + 1e9 * (np.gradient(weight) < 0)), 1])
        reach = float(np.abs(weight).max())
        given = self.given
        self.share = float(self.rng.uniform(0.5, 0.8)) if given["share"] is None else float(given["share"])
        self.ratio = float(self.rng.choice([0.15, 0.25, 0.4])) if given["lever_ratio"] is None else float(given["lever_ratio"])
        compliance = given["compliance_rad_per_Nm"]
        self.compliance = abs(self.size(4e-4)) / reach if compliance is None else float(compliance)
        self._force = 1.0
        self._force = self.share * reach / float(np.abs(self._torque(q[:, 1])).max())
        return {"where": self.names([1]), "share": self.share, "lever_ratio": self.ratio, "wound_up_rad_per_Nm": self.compliance}

    def _torque(self, q2: np.ndarray) -> np.ndarray:
        """N m, that lifts the link: the anchor stands upright behind the axis, the rod's other end turns with the link."""
        anchor, end = np.array([0.0, 1.0]), self.ratio * np.stack([np.sin(q2 - self._upright), np.cos(q2 - self._upright)], axis=1)
        rod = anchor - end
        length = np.linalg.norm(rod, axis=1)
        force = self._force * (1.0 + 0.8 * (length - (1 - self.ratio)) / (2 * self.ratio))
        pull = force[:, None] * rod / length[:, None]
        return -(end[:, 0] * pull[:, 1] - end[:, 1] * pull[:, 0])

    def displace(self, at: Moments, moved: Moved) -> None:
        load = self.cell.masses.torque(self.arm, at.q)[:, 1] + self._torque(at.q[:, 1])
        moved.joint[:, 1] += self.compliance * load
