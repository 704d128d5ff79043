"""A hollow wrist whose shafts run inside one another: turning one carries the next along a little, uncompensated."""

from __future__ import annotations

from typing import Any

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class WristCoupling(InjectedEffect):
    options = {"where": None, "ratio": None}

    def draw(self) -> dict[str, Any]:
        last = self.cell.n - 1
        if self.given["where"] is not None:
            pair = self.axes([])
            if len(pair) != 2:
                raise ConfigError("fake.hidden: wrist_coupling acts between two axes, e.g. where: [A4, A5]; correct the plan")
            self.source, self.target = pair
        else:
            choices = ((last - 2, last - 1), (last - 2, last), (last - 1, last))
            self.source, self.target = choices[int(self.rng.integers(3))]
        self.ratio = self.size(4e-4) if self.given["ratio"] is None else float(self.given["ratio"])
        return {"where": self.names([self.source, self.target]), "ratio": self.ratio}

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.joint[:, self.target] += self.ratio * at.q[:, self.source]
