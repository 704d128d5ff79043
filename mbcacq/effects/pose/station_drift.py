"""A tripod that creeps while its station is measured, evenly in time; drift_mm is from the first to the last pose there, in base axes."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, vector

NAME = "station_drift"


def candidates(context: Context) -> list[Candidate]:
    """For each station of five or more centres, a drift (3,) in mm."""
    key = context.order.astype(float) if context.obs.time_s is None else context.time
    out = []
    for k, station in enumerate(context.obs.cell.stations):
        here = context.obs.station == k
        if here.sum() < 5 or np.ptp(key[here]) == 0:
            continue
        progress = np.where(here, (key - key[here].min()) / np.ptp(key[here]), 0.0)[:, None]
        R = context.state.T_base_station[k, :3, :3]
        parts = [Part("station", 0, c, progress * R[:, c]) for c in range(3)]  # coefficients along the base axes
        out.append(
            Candidate(
                NAME,
                (f"station{station.id}",),
                "time" if context.obs.time_s is not None else "pose",
                lambda _, p=parts: p,
                lambda c, v, _: {"drift_mm": vector(c, v)},
                np.full(3, 0.05),
            )
        )
    if not out:
        raise Missing("no station with five poses")
    return out
