"""A tripod that creeps while its station is measured, evenly in time; drift_mm is from the first to the last pose there, in base axes."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, StandstillRows, vector
from mbcacq.effects.functions import DescribedPart, Function, Product, scaled

NAME = "station_drift"
DECLARED = Declaration(acts_in_time=True, needs=("time_s",), challenge=Challenge(number=16))
FEWEST = 3  # poses: two that see an artefact determine its drift, a third says whether it is one


def candidates(context: Context) -> list[Candidate]:
    """For each station of three or more poses, a drift (3,) in mm."""
    clock = "pose" if context.obs.time_s is None else "time"
    key = context.order.astype(float) if context.obs.time_s is None else context.time
    out = []
    for k, station in enumerate(context.obs.cell.stations):
        here = context.obs.station == k
        if here.sum() < FEWEST or np.ptp(key[here]) == 0:
            continue
        begin, length = float(key[here].min()), float(np.ptp(key[here]))
        this = Function("station", "is", (float(k),))
        progress = (Product(1 / length, (this, Function(clock))), Product(-begin / length, (this,)))
        R = context.state.T_base_station[k, :3, :3]
        # Coefficients along the base axes.
        parts = [DescribedPart("station", 0, c, tuple(scaled(progress, R[j, c]) for j in range(3))) for c in range(3)]
        rows = StandstillRows(parts, np.full(3, 0.05))
        out.append(Candidate(NAME, (f"station{station.id}",), clock, rows, lambda c, v, _: {"drift_mm": vector(c, v)}))
    if not out:
        raise Missing("no station with three poses")
    return out
