"""How long a plan takes: jerk-limited motions, settling, exposures. An operator's time is not counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import ruckig

from mbcacq.devices import MotionLimits
from mbcacq.errors import ConfigError
from mbcacq.plan.motion_limits import motion_limits, sweep_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.schema import Sweep
from mbcacq.quantities import in_degrees


@dataclass(frozen=True)
class Duration:
    """Seconds, and how often the artefact is moved by hand or positioner."""

    motion_s: float
    settle_s: float
    exposure_s: float
    station_changes: int

    @property
    def total_s(self) -> float:
        return self.motion_s + self.settle_s + self.exposure_s


def duration(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> Duration:
    """Time of a whole run, from home to home, at the plan's own speed."""
    limits, plan = motion_limits(loaded), loaded.plan
    stops = stopping_points(loaded, poses, transits)
    motion = sum(motion_time(a, b, limits) for a, b in pairwise(stops)) + sum(sweep_time(loaded, pose) for pose in poses)
    changes = sum(a.station != b.station for a, b in pairwise(poses))
    exposures = sum(p.exposures for p in poses if p.sweep is None)
    return Duration(motion, (len(stops) - 1) * plan.robot.settle_s, exposures * plan.scanner.scan_time_s, changes)


def sweep_time(loaded: LoadedPlan, pose: PlannedPose) -> float:
    """s of a sweep forth and back; 0 for a pose at rest."""
    step = loaded.plan.steps[pose.step]
    if pose.sweep is None or not isinstance(step, Sweep):
        return 0.0
    return 2 * motion_time(pose.q, pose.sweep, sweep_limits(loaded, pose.q, pose.sweep, step.speed_mm_s))


def stopping_points(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> list[np.ndarray]:
    """Joint positions (n,) rad at which the arm stops, in order, from home to home."""
    home = loaded.plan.robot.home
    stops = [home]
    for pose, transit in zip(poses, transits, strict=True):
        stops += [*transit, pose.q]
    return [*stops, home]


def motion_time(start: np.ndarray, end: np.ndarray, limits: MotionLimits) -> float:
    """s of one jerk-limited joint motion (n,) rad from rest to rest."""
    return float(joint_motion(start, end, limits).duration)


def joint_motion(start: np.ndarray, end: np.ndarray, limits: MotionLimits) -> ruckig.Trajectory:
    """The jerk-limited joint motion (n,) rad from rest to rest. Raises ConfigError for limits with which it cannot be timed."""
    wanted = ruckig.InputParameter(len(start))
    wanted.current_position, wanted.target_position = start.tolist(), end.tolist()
    wanted.max_velocity, wanted.max_acceleration = limits.speed.tolist(), limits.acceleration.tolist()
    wanted.max_jerk = limits.jerk.tolist()
    trajectory = ruckig.Trajectory(len(start))
    try:
        result = ruckig.Ruckig(len(start)).calculate(wanted, trajectory)
    except (ruckig.RuckigError, ValueError):  # the latter: a result that its Python bindings do not know
        result = ruckig.Result.Error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        axis = int(np.argmax(np.abs(end - start) / limits.speed))
        raise ConfigError(
            f"a motion of {in_degrees(abs(end - start)[axis]):.3g}° of A{axis + 1} at {in_degrees(limits.speed[axis]):.3g} °/s cannot "
            "be timed: it would take hours, or its acceleration_time_s or jerk_time_s is extreme; set robot: speed higher (0.05 is slow), "
            "and these times to 0.1 s to 1 s"
        )
    return trajectory
