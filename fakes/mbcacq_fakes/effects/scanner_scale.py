"""A scanner whose length unit is off: its projector and camera stand a little closer or wider than its calibration says."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments


class ScannerScale(InjectedEffect):
    options = {"scale_ppm": None, "axis": None}

    def draw(self) -> dict[str, Any]:
        given = self.given["scale_ppm"]
        if given is not None:
            self.scale = np.broadcast_to(np.array(given, dtype=float) * 1e-6, 3).copy()
        else:
            axis = self.given["axis"] or self.rng.choice(["all", "z"])
            self.scale = np.zeros(3)
            self.scale[slice(None) if axis == "all" else "xyz".index(axis)] = self.size(7e-4)
        same = np.ptp(self.scale) == 0
        return {"where": ["scanner"], "scale_ppm": float(self.scale[0] * 1e6) if same else (self.scale * 1e6).tolist()}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        return points * (1 + self.scale)
