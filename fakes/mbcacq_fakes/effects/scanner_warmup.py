"""A scanner that settles while it warms up: its measured points drift away from where they first were."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments


class ScannerWarmup(InjectedEffect):
    options = {"offset_mm": None, "time_constant_s": None}

    def draw(self) -> dict[str, Any]:
        given = self.given
        offset = self.vector(0.06)
        offset[2] *= 2  # depth suffers most: the triangulation base grows
        self.offset = offset if given["offset_mm"] is None else np.array(given["offset_mm"], dtype=float)
        run_s = self.cell.planned_poses * self.cell.pace_s
        self.constant = self.rng.uniform(0.1, 0.35) * run_s if given["time_constant_s"] is None else float(given["time_constant_s"])
        return {"where": ["scanner"], "offset_mm": self.offset.tolist(), "time_constant_s": float(self.constant)}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        return points + (np.exp(-at.time_s / self.constant)[:, None] * self.offset)[pose]
