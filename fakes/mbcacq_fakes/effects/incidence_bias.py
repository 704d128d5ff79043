"""Light that creeps along a tilted surface: the measured artefact is displaced by how much it leans away from the scanner."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments
from mbcacq_fakes.world.rigid import invert


class IncidenceBias(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        self.depth, self.side = self.size(0.25), self.size(0.12)
        return {"where": ["scanner"], "depth_mm": self.depth, "side_mm": self.side}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        T = invert(self.arm.flange(at.q) @ self.cell.hand_eye) @ self.cell.station_pose[at.station]
        up = T[:, :3, 2]
        sine2 = 1 - up[:, 2] ** 2
        return points + (self.depth * sine2[:, None] * np.array([0, 0, 1.0]) + self.side * sine2[:, None] * up * [1, 1, 0])[pose]
