"""A bearing that runs out: the link wobbles about its axis, several times a turn, without any error of its angle."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class AxisWobble(InjectedEffect):
    """The tilt turns ``lobes`` times a turn of the joint; once a turn would be a tilted axis, which is geometry."""

    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(min(self.cell.n, 4)))
        self.lobes, self.phase = int(self.rng.integers(2, 6)), float(self.rng.uniform(-np.pi, np.pi))
        self.tilt = abs(self.size(2e-4 if self._axes[0] < 2 else 4e-4))
        return {
            "where": self.names(self._axes, "link"),
            "depends_on": self.names(self._axes, "q"),
            "lobes": self.lobes,
            "tilt_rad": self.tilt,
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        for i in self._axes:
            angle = self.lobes * at.q[:, i] + self.phase
            # Fixed in the housing: the tilt lies across the axis as it stands before the joint, expressed in the frame behind it.
            across = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(at))], axis=1)
            frames = self.arm.frames(at.q)
            turn = np.swapaxes(frames[:, i + 1, :3, :3], 1, 2) @ frames[:, i, :3, :3]
            moved.frame[:, i + 1, 3:] += self.tilt * (turn @ across[:, :, None])[:, :, 0]
