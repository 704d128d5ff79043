"""The scanner's cable pulls at its mount: the more the hand axis is bent to either side, the more it leans."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class CableAtMount(InjectedEffect):
    """The cable's length grows with the square of the sine of half its bend on either side: one lean each half turn."""

    def draw(self) -> dict[str, Any]:
        self._joint = self.cell.n - 2
        self.lean = self.vector(6e-4)
        return {"where": ["mount"], "depends_on": [f"q{self._joint + 1}"], "lean_rad": self.lean.tolist()}

    def displace(self, at: Moments, moved: Moved) -> None:
        bent = np.sin(at.q[:, self._joint]) ** 2
        moved.frame[:, self.cell.n, 3:] += bent[:, None] * self.lean
