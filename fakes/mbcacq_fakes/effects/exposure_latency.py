"""The scanner exposes a moment after the joint angles were noted; only a moving arm shows it."""

from __future__ import annotations

from typing import Any

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class ExposureLatency(InjectedEffect):
    options = {"latency_s": None}

    def draw(self) -> dict[str, Any]:
        self.latency = abs(self.size(0.004)) if self.given["latency_s"] is None else float(self.given["latency_s"])
        return {"where": ["scanner"], "latency_s": self.latency}

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.joint += self.latency * at.velocity
