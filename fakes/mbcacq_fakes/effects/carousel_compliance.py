"""A carousel bearing that gives way under the overturning moment of everything above it, across the first axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.arm import STANDARD_GRAVITY
from mbcacq_fakes.world.hooks import Moments, Moved


class CarouselCompliance(InjectedEffect):
    options = {"compliance_rad_per_Nm": None}

    def draw(self) -> None:
        given = self.given["compliance_rad_per_Nm"]
        moment = float(np.linalg.norm(self._moment(np.zeros((1, self.cell.n)))))
        self.compliance = abs(self.size(3e-4 / max(moment, 1.0))) if given is None else float(given)

    def _moment(self, q: np.ndarray) -> np.ndarray:
        """(P, 3) N m about the origin behind the first link, without the part along the first axis, in the axes of that frame."""
        frames = self.arm.frames(q)
        centres, mass = self.cell.masses.weights(self.arm, q)
        beyond = np.arange(len(mass)) >= 1
        force = STANDARD_GRAVITY * mass[beyond, None] * self.cell.masses.gravity
        moment = np.cross((centres - frames[:, None, 1, :3, 3])[:, beyond], force).sum(axis=1) * 1e-3
        axis = self._first_axis(q)
        moment -= np.sum(moment * axis, axis=1, keepdims=True) * axis
        return np.einsum("pdc,pd->pc", frames[:, 1, :3, :3], moment)

    def _first_axis(self, q: np.ndarray) -> np.ndarray:
        """(P, 3) in the base: the direction that the first link keeps while it turns."""
        step = np.zeros_like(q)
        step[:, 0] = 1.0
        turn = self.arm.frames(q + step)[:, 1, :3, :3] @ np.swapaxes(self.arm.frames(q)[:, 1, :3, :3], 1, 2)
        axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1)
        return axis / np.linalg.norm(axis, axis=1, keepdims=True)

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.frame[:, 1, 3:] += self.compliance * self._moment(at.q)

    def truth(self) -> dict[str, Any]:
        return {"where": ["link1"], "compliance_rad_per_Nm": self.compliance}
