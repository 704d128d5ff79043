"""A hollow link that twists about its own length under the weight that hangs off it sideways."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.arm import STANDARD_GRAVITY
from mbcacq_fakes.world.hooks import Moments, Moved


class LinkBending(InjectedEffect):
    """The twist saturates: castings bolt together in joints that lift a little and then bear."""

    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes([i for i in (1, 2) if i < self.cell.n])
        self.twist, self.bears = abs(self.size(5e-4)), 0.4
        self._scale = float(np.std(self._moment(self.planned, self._axes[0])[0])) or 1.0
        return {"where": self.names(self._axes, "link"), "depends_on": ["gravity"], "twist_rad": self.twist}

    def _moment(self, q: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Twisting moment (P,) N m about the long axis of link i, and that axis (P, 3) in the frame behind the link."""
        frames = self.arm.frames(q)
        along = frames[:, i + 1, :3, 3] - frames[:, i, :3, 3]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        centres, mass = self.cell.masses.weights(self.arm, q)
        beyond = np.arange(len(mass)) > i
        arm = (centres - frames[:, None, i + 1, :3, 3])[:, beyond]
        moment = np.cross(arm, STANDARD_GRAVITY * mass[beyond, None] * self.cell.masses.gravity).sum(axis=1) * 1e-3
        return (moment * along).sum(axis=1), np.einsum("pdc,pd->pc", frames[:, i + 1, :3, :3], along)

    def displace(self, at: Moments, moved: Moved) -> None:
        for i in self._axes:
            moment, along = self._moment(at.q, i)
            moved.frame[:, i + 1, 3:] += (self.twist * np.tanh(self.bears * moment / self._scale) / self.bears)[:, None] * along
