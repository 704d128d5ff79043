"""A scanner with play in its mount: it rests on one of two seats until its weight overcomes friction and drops it on the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved

STICKS = 0.05  # of its weight


class MountClearance(InjectedEffect):
    options = {"play_mm": None, "play_deg": None}

    def draw(self) -> dict[str, Any]:
        self.line, other = self.rng.standard_normal((2, 3))
        self.line = self.line / np.linalg.norm(self.line)
        across = np.cross(self.line, other)
        play, tip = self.given["play_mm"], self.given["play_deg"]
        self.play = abs(self.size(0.05)) if play is None else float(play)
        self.tip = abs(self.size(3e-4)) if tip is None else float(np.radians(tip))
        self._half = np.r_[self.play / 2 * self.line, self.tip / 2 * across / np.linalg.norm(across)]
        self._seat = 0.0
        return {"where": ["mount"], "play_mm": self.play, "play_deg": float(np.degrees(self.tip))}

    def displace(self, at: Moments, moved: Moved) -> None:
        flange = self.arm.flange(at.q + moved.joint)
        along = np.einsum("c,pcd,d->p", self.cell.masses.gravity, flange[:, :3, :3], self.line)
        for p, pull in enumerate(along):
            if abs(pull) > STICKS or not self._seat:
                self._seat = float(np.sign(pull)) or 1.0
            moved.frame[p, -1] += self._seat * self._half
