"""A slewing ring on an uneven plate: the carousel leans over a few times in a turn of the first axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class UnevenRing(InjectedEffect):
    """Once a turn would be a tilted axis, which is geometry."""

    def draw(self) -> dict[str, Any]:
        self.lobes, self.phase = int(self.rng.integers(2, 4)), float(self.rng.uniform(-np.pi, np.pi))
        self.tilt = abs(self.size(2e-4))
        side = float(self.rng.uniform(-np.pi, np.pi))
        self._about = np.array([np.cos(side), np.sin(side), 0.0])
        return {"where": ["base"], "depends_on": ["q1"], "lobes": self.lobes, "tilt_rad": self.tilt}

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.frame[:, 0, 3:] += self.tilt * np.cos(self.lobes * at.q[:, :1] + self.phase) * self._about
