"""The poses among which the next ones are chosen: those of a plan, random views at its stations, and measured ones once more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.design.adaptive.options import OPTIONS, AdaptiveOptions
from mbcacq.design.candidate_views import candidates
from mbcacq.design.options import DesignOptions
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.routing import router_of

SAME = 1e-3  # rad, below which two postures are one


def reachable_views(loaded: LoadedPlan, seed: int = 0, options: AdaptiveOptions = OPTIONS) -> list[PlannedPose]:
    """Poses of the plan, those that judge left out, and random views of all its stations that can be taken: within limits, seen, nothing
    near. They depend on the cell alone, not on what was measured.
    """
    planned = [p for p in expand_reachable(loaded)[0] if p.phase != "verification"]
    views = DesignOptions(views_per_station=options.views_per_station)
    stations = list(dict.fromkeys(s.id for s in loaded.cell.stations))
    return [*planned, *(c.pose for c in candidates(loaded, stations, options.steepest_deg, seed, views))]


def not_measured(views: Sequence[PlannedPose], measured: Observations, again: bool = False) -> list[PlannedPose]:
    """The views that were not measured yet, as poses to choose from; again: the others too, for what changes with time."""
    new = [p for p in views if again or not _was_measured(p, measured)]
    return [replace(p, number=k, phase="position") for k, p in enumerate(new)]


def routed(loaded: LoadedPlan, pose: PlannedPose) -> bool:
    """Whether there is a free path from home to a pose and back; then there is one between any two of them at a station."""
    router = router_of(loaded)
    return router.approach(pose) is not None and router.retract(pose) is not None


def shortest_order(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> list[PlannedPose]:
    """The poses of a visit, each the nearest (in the largest joint motion) to the one before, from home; those that look at one ball by
    itself follow each other.
    """
    left, out, at = list(poses), list[PlannedPose](), loaded.plan.robot.home
    while left:
        same = [p for p in left if out and len(p.balls) == 1 and p.balls == out[-1].balls] or left
        nearest = min(same, key=lambda p: float(np.abs(p.q - at).max()))
        left = [p for p in left if p is not nearest]
        out.append(nearest)
        at = nearest.q
    return out


def _was_measured(pose: PlannedPose, measured: Observations) -> bool:
    ids = [s.id for s in measured.cell.stations]
    if pose.station not in ids:
        return False
    here = measured.q[measured.station == ids.index(pose.station)]
    return bool(len(here) and np.abs(here - pose.q).max(axis=1).min() < SAME)
