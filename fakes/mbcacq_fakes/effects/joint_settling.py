"""Brakes that close while an arm stands: it hangs in their slack until the drives have taken it through a move again."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class JointSettling(InjectedEffect):
    options = {"where": None, "sag_deg": None, "closes_after_s": 60.0}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes([i for i in (1, 2, 4) if i < self.cell.n])
        given = self.given["sag_deg"]
        self.sag = abs(self.size(1.5e-4 if self._axes[0] < 4 else 4e-4)) if given is None else float(np.radians(given))
        self._arrival, self._arrived_s, self._hangs = -1, -np.inf, True
        return {"where": self.names(self._axes), "sag_deg": float(np.degrees(self.sag))}

    def displace(self, at: Moments, moved: Moved) -> None:
        for p in range(len(at)):
            if at.arrival[p] != self._arrival:  # it moved here, from where it stood until a moment ago
                stood = at.time_s[p] - self._arrived_s
                self._hangs = stood > self.given["closes_after_s"]
                self._arrival, self._arrived_s = int(at.arrival[p]), float(at.time_s[p])
            if self._hangs:
                torque = self.cell.masses.torque(self.arm, at.q[p : p + 1])[0]
                for i in self._axes:
                    moved.joint[p, i] += self.sag * np.sign(torque[i])
