"""A hose clamped before A4 and behind A6: wound up by both, it pulls the hand axis between them aside."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class HoseTwist(InjectedEffect):
    """The moment about the hand axis is the product of how far the hose leaves the arm's plane at either end."""

    def draw(self) -> dict[str, Any]:
        last = self.cell.n - 1
        self._ends, self._target = (last - 2, last), last - 1
        self.pull = self.size(8e-4)
        return {"where": self.names([self._target]), "depends_on": self.names(self._ends, "q"), "pull_rad": self.pull}

    def displace(self, at: Moments, moved: Moved) -> None:
        first, second = self._ends
        moved.joint[:, self._target] += self.pull * np.sin(at.q[:, first]) * np.sin(at.q[:, second])
