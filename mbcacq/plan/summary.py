"""A plan as one plain dictionary: what ``plan show --json`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mbcacq.plan.axis_extremes import axis_extremes
from mbcacq.plan.motion_limits import motion_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.routing import Routes, find_paths
from mbcacq.plan.timing import duration, motion_time


def summary(loaded: LoadedPlan, poses: Sequence[PlannedPose], routes: Routes | None = None) -> dict[str, Any]:
    """Steps, poses (joint angles in deg, start of each in s) and duration; format mbcacq-plan-summary/1. routes: where known already."""
    transits, _ = find_paths(loaded, poses) if routes is None else routes
    total = duration(loaded, poses, transits)
    starts = _starts(loaded, poses, transits)
    return {
        "format": "mbcacq-plan-summary/1",
        "name": loaded.plan.name,
        "robot": loaded.cell.robot.name,
        "scanner": loaded.cell.scanner_name,
        "steps": [_step(loaded, index, poses) for index in range(len(loaded.plan.steps))],
        "poses": [
            {
                "pose": p.number,
                "step": p.step_name,
                "phase": p.phase,
                "station": p.station,
                "artefact": p.artefact,
                "balls": list(p.balls),
                "q_deg": loaded.cell.robot.shown(p.q).round(4).tolist(),
                "exposures": p.exposures,
                "line": p.line,
                "waypoints": len(t),
                "start_s": round(s, 2),
            }
            for p, t, s in zip(poses, transits, starts, strict=True)
        ],
        "duration": {name: getattr(total, name) for name in ("total_s", "motion_s", "settle_s", "exposure_s", "station_changes")},
        "axes": [axis.to_dict() for axis in axis_extremes(loaded, poses, transits)],
    }


def _step(loaded: LoadedPlan, index: int, poses: Sequence[PlannedPose]) -> dict[str, Any]:
    step, own = loaded.plan.steps[index], [p for p in poses if p.step == index]
    return {
        "name": step.name,
        "phase": step.phase,
        "stations": list(dict.fromkeys(p.station for p in own)),
        "poses": len(own),
        "exposures": sum(p.exposures for p in own),
    }


def _starts(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> list[float]:
    """s from the start of the run to the beginning of each pose's first motion, without the operator's time."""
    limits, use = motion_limits(loaded), loaded.plan.robot
    clock, out, last = 0.0, [], use.home
    for pose, transit in zip(poses, transits, strict=True):
        out.append(clock)
        stops = [last, *transit, pose.q]
        clock += sum(motion_time(a, b, limits) + use.settle_s for a, b in pairwise(stops))
        clock += pose.exposures * loaded.plan.scanner.scan_time_s
        last = pose.q
    return out
