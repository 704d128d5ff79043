"""The first block of an investigation: the best few of a plan's own poses for what they show of all effects."""

from __future__ import annotations

from dataclasses import replace

from mbcacq.design.adaptive.next_plan import steps_of
from mbcacq.design.adaptive.options import OPTIONS
from mbcacq.design.adaptive.plan_order import best_of_plan
from mbcacq.design.adaptive.pool import shortest_order
from mbcacq.design.adaptive.visit_choice import Visit
from mbcacq.model import yaml12
from mbcacq.plan import LoadedPlan, load


def first_block(loaded: LoadedPlan) -> LoadedPlan:
    """The plan with its best few poses alone, station by station, as one that other poses are added to."""
    chosen = best_of_plan(loaded, OPTIONS.first_block)
    visits = []
    for station in dict.fromkeys(s.id for s in loaded.cell.stations):
        here = [p for p in chosen if p.station == station]
        if here:
            visits.append(Visit(station=station, poses=tuple(shortest_order(loaded, here)), gain=0.0, value=0.0, seconds=0.0, moves=1))
    data = yaml12.load(loaded.text)
    data["steps"] = steps_of(loaded, visits)
    text = yaml12.dump(data, allow_unicode=True, width=140, default_flow_style=None)
    return replace(load(loaded.path, text), grown_from=len(chosen))
