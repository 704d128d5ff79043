"""A pedestal on fresh grout: it sinks and leans at a steady rate, the tripods do not."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class SinkingPedestal(InjectedEffect):
    def draw(self) -> dict[str, Any]:
        self.sink, self.lean = self.vector(0.15), np.append(self.vector(2e-4, 2), 0.0)
        return {"where": ["base"], "depends_on": ["time"], "sink_mm_per_h": self.sink.tolist(), "lean_rad_per_h": self.lean.tolist()}

    def displace(self, at: Moments, moved: Moved) -> None:
        hours = at.time_s[:, None] / 3600
        moved.frame[:, 0] += np.concatenate([hours * self.sink, hours * self.lean], axis=1)
