"""Transmission error from eccentric wheels: each turns a little ahead and behind, once per its own turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class GearTransmissionError(InjectedEffect):
    """A wheel running out by e on its pitch radius leads by atan2(e sin, 1 + e cos): a sine while e is small.

    The wheels: joint side (order 1), its mesh twice a turn (2), the motor side (order of the gear ratio, and twice that).
    """

    options = {"where": None, "order": None, "amplitude_deg": None, "phase_deg": None}

    def draw(self) -> dict[str, Any]:
        self._axes = self.axes(range(self.cell.n))
        ratio = float(self.cell.gear_ratio[self._axes[0]])
        given = self.given
        pool = [1.0, 2.0, ratio, 2 * ratio]
        count = int(self.rng.integers(1, 3))
        orders = self.rng.choice(pool, count, replace=False) if given["order"] is None else np.atleast_1d(given["order"])
        self.order = np.array(orders, dtype=float)
        typical = 2e-4 * (1 if self._axes[0] < 3 else 3)
        drawn = np.array([abs(self.size(typical)) for _ in self.order])
        self.amplitude = drawn if given["amplitude_deg"] is None else np.radians(np.atleast_1d(given["amplitude_deg"]).astype(float))
        phases = self.rng.uniform(-np.pi, np.pi, len(self.order))
        self.phase = phases if given["phase_deg"] is None else np.radians(np.atleast_1d(given["phase_deg"]).astype(float))
        return {
            "where": self.names(self._axes),
            "order": self.order.tolist(),
            "amplitude_deg": np.degrees(self.amplitude).tolist(),
            "phase_deg": np.degrees(self.phase).tolist(),
        }

    def displace(self, at: Moments, moved: Moved) -> None:
        for i in self._axes:
            wheel = self.order * at.q[:, i, None] + self.phase
            moved.joint[:, i] += np.arctan2(self.amplitude * np.sin(wheel), 1 + self.amplitude * np.cos(wheel)).sum(axis=1)
