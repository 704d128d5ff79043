"""A tripod creeping during its station, evenly in time; drift_mm is the whole way from the station's first to its last pose, base axes."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, vector

NAME = "station_drift"


def candidates(s: Context) -> list[Candidate]:
    key = s.order.astype(float) if s.obs.time_s is None else s.time
    out = []
    for k, station in enumerate(s.obs.cell.stations):
        here = s.obs.station == k
        if here.sum() < 5 or np.ptp(key[here]) == 0:
            continue
        way = np.where(here, (key - key[here].min()) / np.ptp(key[here]), 0.0)[:, None]
        R = s.state.T_base_station[k, :3, :3]
        parts = [Part("station", 0, c, way * R[:, c]) for c in range(3)]  # coefficients along the base axes
        out.append(
            Candidate(
                NAME,
                (f"station{station.id}",),
                "time" if s.obs.time_s is not None else "pose",
                lambda _, p=parts: p,
                lambda c, v, _: {"drift_mm": vector(c, v)},
                np.full(3, 0.05),
            )
        )
    if not out:
        raise Missing("no station with five poses")
    return out
