"""A ball that was knocked: it is not where its certificate says."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class BallShift(InjectedEffect):
    options = {"ball": None, "shift_mm": None}

    def draw(self) -> dict[str, Any]:
        balls = self.cell.balls
        self.ball = int(self.rng.choice(self.cell.artefacts[0].balls)) if self.given["ball"] is None else int(self.given["ball"])
        if self.ball not in balls:
            raise ConfigError(f"fake.hidden: ball_shift: there is no ball {self.ball}; correct the plan")
        self.shift = self.vector(0.05) if self.given["shift_mm"] is None else np.array(self.given["shift_mm"], dtype=float)
        return {"where": [f"ball{self.ball}"], "shift_mm": self.shift.tolist()}

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.ball[:, self.cell.balls.index(self.ball)] += self.shift
