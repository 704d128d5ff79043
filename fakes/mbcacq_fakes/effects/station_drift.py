"""A tripod that creeps under its load from the moment the artefact is put on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class StationDrift(InjectedEffect):
    """drift_mm: how far it goes in the time that an even share of the run takes. The direction is fixed in the base frame."""

    options = {"station": None, "drift_mm": None}

    def draw(self) -> dict[str, Any]:
        ids = self.cell.station_ids
        station = str(self.given["station"]) if self.given["station"] is not None else ids[int(self.rng.integers(len(ids)))]
        if station not in ids:
            raise ConfigError(f"fake.hidden: station_drift: there is no station '{station}'; correct the plan")
        self._index, self._id = ids.index(station), station
        drift = self.vector(0.15) if self.given["drift_mm"] is None else np.array(self.given["drift_mm"], dtype=float)
        share_s = self.cell.planned_poses * self.cell.pace_s / len(ids)
        self.rate, self._began, self.total = drift / max(share_s, 1.0), None, np.zeros(3)
        return {"where": [f"station{self._id}"], "rate_mm_per_s": self.rate.tolist()}

    def displace(self, at: Moments, moved: Moved) -> None:
        here = np.flatnonzero(at.station == self._index)
        if not len(here):
            return
        if self._began is None:
            self._began = float(at.time_s[here[0]])
        gone = (at.time_s[here] - self._began)[:, None] * self.rate
        self.total = gone[-1]
        turn = self.cell.station_pose[self._index, :3, :3]
        moved.station[here, :3] += gone @ turn

    def truth(self) -> dict[str, Any]:
        return {**super().truth(), "drift_mm": self.total.tolist()}
