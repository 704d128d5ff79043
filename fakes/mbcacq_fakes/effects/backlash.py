"""Play in a gearbox: the output is dragged along inside its gap, so where it rests depends on where it came from."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class Backlash(InjectedEffect):
    options = {"where": None, "width_deg": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        typical = 3e-4 * (1 if self._axes[0] < 3 else 2.5)
        given = self.given["width_deg"]
        self.width = abs(self.size(typical)) if given is None else float(np.radians(given))
        self._output: np.ndarray | None = None
        return {"where": self.names(self._axes), "width_deg": float(np.degrees(self.width))}

    def displace(self, at: Moments, moved: Moved) -> None:
        half = self.width / 2
        output = at.q[0].copy() if self._output is None and len(at) else self._output
        self._output = output
        if output is None:
            return
        for p in range(len(at)):
            for i in self._axes:
                motor = at.q[p, i]
                # The motor's last stretch came from that side; the play follows it.
                for angle in (motor - at.direction[p, i] * 3 * self.width, motor):
                    output[i] = np.clip(output[i], angle - half, angle + half)
                moved.joint[p, i] += output[i] - motor
