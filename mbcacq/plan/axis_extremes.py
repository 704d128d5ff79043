"""The largest speed, acceleration and jerk of each axis in the motions of a plan, against its limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbcacq.model.json_text import AsJson
from mbcacq.plan.motion_limits import axis_limits, motion_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.timing import joint_motion, stopping_points

SAMPLES = 100  # of a motion: every phase of constant jerk that matters holds several


@dataclass(frozen=True)
class AxisExtremes(AsJson):
    """axis: counted from 1; name: of the axis. Values in deg/s, deg/s^2, deg/s^3 or, of a sliding axis, mm/s .., each with the limit of the
    arm."""

    axis: int
    name: str
    unit: str
    speed: float
    speed_limit: float
    acceleration: float
    acceleration_limit: float
    jerk: float
    jerk_limit: float


def axis_extremes(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> list[AxisExtremes]:
    """One entry an axis, over all motions from home to home, as the tool interpolates them. Raises ConfigError without speed limits."""
    limits, allowed = motion_limits(loaded), axis_limits(loaded)
    largest = np.zeros((3, loaded.cell.robot.n))
    for start, end in pairwise(stopping_points(loaded, poses, transits)):
        trajectory = joint_motion(start, end, limits)
        times = np.linspace(0.0, trajectory.duration, SAMPLES)
        states = np.array([trajectory.at_time(float(t))[1:3] for t in times])  # (SAMPLES, 2, n): speed and acceleration
        step_s = max(float(trajectory.duration) / (SAMPLES - 1), 1e-12)
        jerk = np.abs(np.diff(states[:, 1], axis=0)).max(axis=0) / step_s
        largest = np.maximum(largest, [*np.abs(states).max(axis=0), jerk])
    robot = loaded.cell.robot
    columns = robot.shown(np.array([largest[0], allowed.speed, largest[1], allowed.acceleration, largest[2], allowed.jerk])).T
    return [AxisExtremes(k + 1, robot.axes[k], robot.unit(k).strip(), *row) for k, row in enumerate(columns.tolist())]
