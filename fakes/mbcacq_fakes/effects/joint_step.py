"""An encoder that lost counts, or a mastering that was disturbed, in the middle of the run."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class JointStep(InjectedEffect):
    options = {"where": None, "at_pose": None, "step_deg": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        self.at_pose = self.moment_in_run()
        typical = 2e-4 if self._axes[0] < 3 else 5e-4
        self.step = self.size(typical) if self.given["step_deg"] is None else float(np.radians(self.given["step_deg"]))
        return {"where": self.names(self._axes), "at_pose": self.at_pose, "step_deg": float(np.degrees(self.step))}

    def displace(self, at: Moments, moved: Moved) -> None:
        after = self.pose_number(at) >= self.at_pose
        moved.joint[np.ix_(after, np.array(self._axes))] += self.step
