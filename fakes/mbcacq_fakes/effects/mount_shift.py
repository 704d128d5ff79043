"""The scanner slips on its bracket at some moment."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class MountShift(InjectedEffect):
    options = {"at_pose": None, "translation_mm": None, "rotation_deg": None}

    def draw(self) -> dict[str, Any]:
        self.at_pose = self.moment_in_run()
        given = self.given
        self.translation = self.vector(0.08) if given["translation_mm"] is None else np.array(given["translation_mm"], dtype=float)
        self.rotation = self.vector(2e-4) if given["rotation_deg"] is None else np.radians(np.array(given["rotation_deg"], dtype=float))
        return {
            "where": ["mount"],
            "at_pose": self.at_pose,
            "translation_mm": self.translation.tolist(),
            "rotation_deg": np.degrees(self.rotation).tolist(),
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        after = self.pose_number(at) >= self.at_pose
        moved.frame[after, -1] += np.concatenate([self.translation, self.rotation])
