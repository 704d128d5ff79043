"""Every motion that a run is going to make, examined as a whole before anything moves; and the space it sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.errors import SafetyStop
from mbcacq.plan.clearance import clearance_of
from mbcacq.plan.motion_limits import motion_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit


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
    at the plan's joint speeds. segments: number of motions."""

    low: np.ndarray
    high: np.ndarray
    speed_mm_s: float
    segments: int


def segments(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    paths: Sequence[Transit],
    path_home: Sequence[np.ndarray],
    done: frozenset[int] = frozenset(),
) -> Iterator[MotionSegment]:
    """All motions of a run in order, from home to home; ``done`` poses are passed over."""
    last, station = loaded.plan.robot.home, None
    for pose, transit in zip(poses, paths, strict=True):
        if pose.number in done:
            continue
        for waypoint in transit.retract:
            yield MotionSegment(last, waypoint, station, pose)
            last = waypoint
        station = pose.station
        for waypoint in (*transit.approach, pose.q):
            yield MotionSegment(last, waypoint, station, pose)
            last = waypoint
    for waypoint in path_home:
        yield MotionSegment(last, waypoint, station, None)
        last = waypoint


def refuse_unsafe(loaded: LoadedPlan, motions: Sequence[MotionSegment]) -> None:
    """Joint limits, workspace and clearance along every segment. Raises SafetyStop naming the first that fails."""
    clearance = clearance_of(loaded)
    for segment in motions:
        pose = segment.pose
        where = "on the way home" if pose is None else f"on the way to pose {pose.number} (step '{pose.step_name}')"
        _refuse_outside_limits(loaded, segment, where)
        near = clearance.along_segment(segment.start, segment.end, segment.station, loaded.plan.clearance_mm)
        if near is not None:
            raise SafetyStop(
                f"{where} {near.a} would come within {near.distance:.0f} mm of {near.b}; nothing was moved: change the views "
                "or the stations (mbcacq plan check)"
            )


def _refuse_outside_limits(loaded: LoadedPlan, segment: MotionSegment, where: str) -> None:
    limits, rounding = loaded.cell.robot.limits, loaded.planning.limit_rounding
    for q in (segment.start, segment.end):  # what lies between two points within the limits is within them
        outside = ~np.isfinite(q) | (q < limits[:, 0] - rounding) | (q > limits[:, 1] + rounding)
        if outside.any():
            axis = int(np.argmax(outside))
            robot = loaded.cell.robot
            at = f"{robot.axes[axis]} would reach {robot.shown(q)[axis]:.1f}{robot.unit(axis)}"
            raise SafetyStop(f"{where} {at}, outside its limits; nothing was moved")


def swept(loaded: LoadedPlan, motions: Sequence[MotionSegment]) -> Swept:
    """Box and speed of flange and scanner over all segments."""
    robot, fastest = loaded.cell.robot, motion_limits(loaded).speed
    low, high, speed = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for segment in motions:
        travel = segment.end - segment.start
        n = 2 + int(np.max(np.abs(travel)) / loaded.planning.preview_step)
        flange = robot.chain.flange(segment.start + np.linspace(0, 1, n)[:, None] * travel)
        scanner = (flange @ loaded.cell.T_flange_scanner)[:, :3, 3]
        both = np.concatenate([flange[:, :3, 3], scanner])
        low, high = np.minimum(low, both.min(axis=0)), np.maximum(high, both.max(axis=0))
        least_s = float(np.max(np.abs(travel) / fastest))
        if least_s > 0:
            speed = max(speed, float(np.linalg.norm(np.diff(scanner, axis=0), axis=1).max()) * (n - 1) / least_s)
    return Swept(low, high, speed, len(motions))
