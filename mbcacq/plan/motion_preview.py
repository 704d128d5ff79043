"""Everything a run is going to drive, leg by leg, looked at once more as a whole before anything moves; and what it sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.errors import SafetyStop
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.motion_limits import motion_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit

STEP = np.radians(2.0)  # between two looks at where flange and scanner are; for the figures, not for the clearance
ROUNDING = 1e-9


@dataclass(frozen=True)
class MotionSegment:
    """A joint-straight motion from start to end (n,) rad, the artefact at ``station`` (None: at none yet). pose: towards it; None: home."""

    start: np.ndarray
    end: np.ndarray
    station: str | None
    pose: PlannedPose | None


@dataclass(frozen=True)
class Swept:
    """low, high: (3,) mm, base frame, box around all places of flange and scanner frame. speed_mm_s: fastest of the scanner frame's origin,
    at the plan's joint speeds. legs: motions."""

    low: np.ndarray
    high: np.ndarray
    speed_mm_s: float
    legs: int


def legs(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    paths: Sequence[Transit],
    way_home: Sequence[np.ndarray],
    done: frozenset[int] = frozenset(),
) -> Iterator[MotionSegment]:
    """All motions of a run in order, from home to home; ``done`` poses are passed over."""
    at, station = np.radians(loaded.plan.robot.home_deg), None
    for pose, path in zip(poses, paths, strict=True):
        if pose.number in done:
            continue
        for waypoint in path.leave:
            yield MotionSegment(at, waypoint, station, pose)
            at = waypoint
        station = pose.station
        for waypoint in (*path.approach, pose.q):
            yield MotionSegment(at, waypoint, station, pose)
            at = waypoint
    for waypoint in way_home:
        yield MotionSegment(at, waypoint, station, None)
        at = waypoint


def refuse_unsafe(loaded: LoadedPlan, way: Sequence[MotionSegment]) -> None:
    """The last look: joint limits, workspace and clearance along every leg. Raises SafetyStop naming the first that fails."""
    limits, clearance = loaded.cell.robot.limits, Clearance(loaded)
    for leg in way:
        where = "on the way home" if leg.pose is None else f"on the way to pose {leg.pose.number} (step '{leg.pose.step_name}')"
        for q in (leg.start, leg.end):  # what lies between two points within the limits is within them
            outside = ~np.isfinite(q) | (q < limits[:, 0] - ROUNDING) | (q > limits[:, 1] + ROUNDING)
            if outside.any():
                axis = int(np.argmax(outside))
                raise SafetyStop(f"{where} A{axis + 1} would reach {np.degrees(q[axis]):.1f} deg, outside its limits; nothing was moved")
        near = clearance.on_way(leg.start, leg.end, leg.station, loaded.plan.clearance_mm)
        if near is not None:
            raise SafetyStop(
                f"{where} {near.a} would come within {near.distance:.0f} mm of {near.b}; nothing was moved: change the views "
                "or the stations (mbcacq plan check)"
            )


def swept(loaded: LoadedPlan, way: Sequence[MotionSegment]) -> Swept:
    """Box and speed of flange and scanner over all legs."""
    robot, fastest = loaded.cell.robot, motion_limits(loaded).speed
    low, high, speed = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for leg in way:
        travel = leg.end - leg.start
        n = 2 + int(np.max(np.abs(travel)) / STEP)
        flange = robot.chain.flange(leg.start + np.linspace(0, 1, n)[:, None] * travel)
        scanner = (flange @ loaded.cell.T_flange_scanner)[:, :3, 3]
        both = np.concatenate([flange[:, :3, 3], scanner])
        low, high = np.minimum(low, both.min(axis=0)), np.maximum(high, both.max(axis=0))
        least_s = float(np.max(np.abs(travel) / fastest))
        if least_s > 0:
            speed = max(speed, float(np.linalg.norm(np.diff(scanner, axis=0), axis=1).max()) * (n - 1) / least_s)
    return Swept(low, high, speed, len(way))
