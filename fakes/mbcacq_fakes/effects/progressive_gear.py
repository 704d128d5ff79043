"""A gearbox with a progressive characteristic: preloaded at rest, it gives way with the cube of the torque."""

from __future__ import annotations

from typing import Any

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class ProgressiveGear(InjectedEffect):
    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes([i for i in (1, 2) if i < self.cell.n])
        self.wind_up = abs(self.size(6e-4))
        planned = self.cell.planned_q
        torque = None if planned is None or not len(planned) else self.cell.masses.torque(self.arm, planned)
        self._reach = 1.0 if torque is None else float(abs(torque[:, self._axes[0]]).max()) or 1.0
        where = self.names(self._axes)
        return {"where": where, "depends_on": [f"gravity_torque_{i + 1}" for i in self._axes], "wind_up_rad": self.wind_up}

    def displace(self, at: Moments, moved: Moved) -> None:
        torque = self.cell.masses.torque(self.arm, at.q)
        for i in self._axes:
            moved.joint[:, i] += self.wind_up * (torque[:, i] / self._reach) ** 3
