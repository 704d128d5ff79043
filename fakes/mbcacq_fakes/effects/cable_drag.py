"""A stiff hose package: wound up by the last axis, it pulls a wrist joint aside until it is taut."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class CableDrag(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        last = self.cell.n - 1
        self.source, self.target = ((last, last - 1), (last - 2, last - 1), (0, 1))[int(self.rng.integers(3))]
        self.slack, self.rest = self.rng.uniform(0.2, 0.5), self.rng.uniform(-0.6, 0.6)
        self.pull = self.size(6e-4 if self.target > 2 else 3e-4)
        return {"where": self.names([self.target]), "depends_on": self.names([self.source], "q"), "pull_rad": self.pull}

    def displace(self, at: Moments, moved: Moved) -> None:
        wound = at.q[:, self.source] - self.rest
        moved.joint[:, self.target] += self.pull * np.tanh(np.abs(wound) / self.slack) ** 2
