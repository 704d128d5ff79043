"""Lens errors that remain in the scanner's calibration: every measured point is a little off, depending on where in the field it lies."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments

EDGE = 45.0  # mm, where in the field the typical size is reached


class ScannerDistortion(InjectedEffect):
    """kind: curvature (the field bends, depth grows with the square of the radius), radial (cushion or barrel), depth (magnification
    changes with distance)."""

    options = {"kind": None}

    def draw(self) -> dict[str, Any]:
        self.kind = str(self.given["kind"] or self.rng.choice(["curvature", "radial", "depth"]))
        power = {"curvature": 2, "radial": 3, "depth": 2}[self.kind]
        self.coefficient = self.size(0.06) / EDGE**power
        name = {"curvature": "field_curvature_per_mm", "radial": "radial_per_mm2", "depth": "depth_scale_per_mm"}[self.kind]
        return {"where": ["scanner"], name: self.coefficient}

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        out = points.copy()
        radius2 = (points[:, :2] ** 2).sum(axis=1)
        if self.kind == "curvature":
            out[:, 2] += self.coefficient * radius2
        elif self.kind == "radial":
            out[:, :2] *= 1 + self.coefficient * radius2[:, None]
        else:
            out[:, :2] *= 1 + self.coefficient * points[:, 2:]
        return out
