"""A gearbox that is soft about zero torque: a stack of a soft spring between two stops and a stiff one."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class LostMotion(InjectedEffect):
    """Stiffness K1 up to the torque T1, K2 beyond: drawn as a lost motion and a compliance beyond, as data sheets give them.

    With a second lost motion that ends at a second torque the gear has three stiffnesses.
    """

    options = {
        "where": None,
        "lost_motion_deg": None,
        "breakpoint_Nm": None,
        "compliance_rad_per_Nm": None,
        "second_lost_motion_deg": 0.0,
        "second_breakpoint_Nm": 1.0,
    }

    def draw(self) -> dict[str, Any]:
        loaded = [i for i in (1, 2) if i < self.cell.n]
        self._axes = self.axes(loaded)
        (i,) = self._axes
        reach = float(np.abs(self.cell.masses.torque(self.arm, self.planned)[:, i]).max())
        given = self.given
        self.lost = abs(self.size(4e-4)) if given["lost_motion_deg"] is None else float(np.radians(given["lost_motion_deg"]))
        share = float(self.rng.uniform(0.12, 0.4))
        self.breakpoint = share * reach if given["breakpoint_Nm"] is None else float(given["breakpoint_Nm"])
        self.second = float(np.radians(given["second_lost_motion_deg"])), float(given["second_breakpoint_Nm"])
        beyond = given["compliance_rad_per_Nm"]
        self.beyond = self.strength * float(self.rng.uniform(0.3, 1.0)) * 1.5e-4 / reach if beyond is None else float(beyond)
        return {
            "where": self.names(self._axes),
            "lost_motion_deg": float(np.degrees(self.lost)),
            "breakpoint_Nm": self.breakpoint,
            "beyond_rad_per_Nm": self.beyond,
        }

    def _wound(self, torque: np.ndarray) -> np.ndarray:
        """Springs in series, of which the soft ones meet their stops at T1 and T2."""
        gap, load = 0.0, np.abs(torque)
        for lost, breakpoint in ((self.lost, self.breakpoint), self.second):
            gap = gap + np.minimum(load * lost / 2 / breakpoint, lost / 2)
        return np.sign(torque) * (gap + load * self.beyond)

    def displace(self, at: Moments, moved: Moved) -> None:
        (i,) = self._axes
        commanded, wound = at.q + moved.joint, at.q + moved.joint
        for _ in range(4):
            torque = self.cell.masses.torque(self.arm, wound)[:, i]
            wound = commanded.copy()
            wound[:, i] += self._wound(torque)
        moved.joint += wound - commanded
