"""A tool heavier, or hung elsewhere, than declared. Only an elastic arm shows it; this arm is elastic, by an amount the plan may give."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.description import CellFacts
from mbcacq_fakes.world.hooks import Moments, Moved


class Payload(InjectedEffect):
    """mass_kg, com_mm: of the true tool. compliance_rad_per_Nm: of A2 and A3; 0 leaves the bending to other effects."""

    options = {"mass_kg": None, "com_mm": None, "compliance_rad_per_Nm": 2e-6}

    def alter(self, cell: CellFacts) -> CellFacts:
        rng = np.random.default_rng(self._seed if self._seed is not None else 1)
        declared, mass, com = cell.masses, self.given["mass_kg"], self.given["com_mm"]
        self.mass = declared.payload_mass + self.strength * rng.uniform(1.5, 3.0) if mass is None else float(mass)
        self.com = declared.payload_com + self.strength * rng.uniform(-40, 40, 3) if com is None else np.array(com, dtype=float)
        return dataclasses.replace(cell, masses=dataclasses.replace(declared, payload_mass=self.mass, payload_com=self.com))

    def draw(self) -> dict[str, Any]:
        self.compliance = np.zeros(self.cell.n)
        self.compliance[1:3] = float(self.given["compliance_rad_per_Nm"])
        return {
            "where": ["mount"],
            "mass_kg": self.mass,
            "com_mm": np.asarray(self.com).tolist(),
            "compliance_rad_per_Nm": self.compliance.tolist(),
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.joint += self.compliance * self.cell.masses.torque(self.arm, at.q + moved.joint)
