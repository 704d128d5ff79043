"""A bearing with a spalled raceway: where the damage comes under the rollers that carry the load, the link sinks in and tilts."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class SpalledRaceway(InjectedEffect):
    """The rollers share the load as Stribeck has it for a bearing with clearance, and none outside the loaded zone has any.

    A1 carries the overhang: its loaded side is under the arm's centre of mass, and the damage is in the ring that stands. A2 and A3
    carry the weight: the loaded side is below, and the damage is in the ring that turns.
    """

    options = {"where": None}

    def draw(self) -> dict[str, Any]:
        self._joint = self.axes(range(min(self.cell.n, 3)))[0]
        self.tilt = abs(self.size(4e-4))
        self.half_width = float(np.radians(self.rng.uniform(25, 45)))
        passed, about = self._loaded_side(self.planned)
        # A tilt about the next joint's axis, which passes through the frame behind the link, is an error of that joint's angle.
        next_axis = self.arm.frames(self.planned)[:, self._joint + 1, :3, 2]
        self._is_next_joint = bool(np.mean((about * next_axis).sum(axis=1) ** 2) > 0.95)
        # The damage lies where the bearing is loaded now and then: counted from the mean direction, in the middle of what occurs.
        mean = np.angle(np.exp(1j * passed).mean())
        self.at = float(mean + np.quantile(np.angle(np.exp(1j * (passed - mean))), self.rng.uniform(0.25, 0.75)))
        turned = range(self._joint, self._joint + 1) if self._joint < 2 else (1, 2)
        return {
            "where": self.names([self._joint], "link"),
            "observable_at": self.names([self._joint + 1]) if self._is_next_joint else [],
            "depends_on": self.names(turned, "q"),
            "tilt_rad": self.tilt,
            "half_width_rad": self.half_width,
        }

    def _loaded_side(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (P,) rad in the damaged ring of the middle of the loaded zone, and about what (P, 3), base frame, the link tilts there."""
        i, frames = self._joint, self.arm.frames(q)
        about = frames[:, i, :3, 2]
        if i == 0:
            centres, mass = self.cell.masses.weights(self.arm, q)
            beyond = np.arange(len(mass)) >= i
            load = np.einsum("pkc,k->pc", centres[:, beyond], mass[beyond]) / mass[beyond].sum() - frames[:, i, :3, 3]
        else:
            load = np.broadcast_to(self.cell.masses.gravity, (len(q), 3))
        across = load - (load * about).sum(axis=1, keepdims=True) * about
        across = across / np.linalg.norm(across, axis=1, keepdims=True)
        angle = np.arctan2((across * frames[:, i, :3, 1]).sum(axis=1), (across * frames[:, i, :3, 0]).sum(axis=1))
        return angle - (self.cell.sign[i] * q[:, i] if i else 0.0), np.cross(about, across)

    def displace(self, at: Moments, moved: Moved) -> None:
        angle, about = self._loaded_side(at.q)
        clearance = 1 - np.cos(self.half_width)
        share = np.maximum(1 - (1 - np.cos(angle - self.at)) / clearance, 0) ** 1.11  # line contact
        behind = self.arm.frames(at.q)[:, self._joint + 1, :3, :3]
        moved.frame[:, self._joint + 1, 3:] += self.tilt * share[:, None] * np.einsum("pij,pi->pj", behind, about)
