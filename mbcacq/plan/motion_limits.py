"""How fast the axes may move, where they may go, and how long a motion may take."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.devices import MotionLimits, SafetyStop
from mbcacq.errors import ConfigError
from mbcacq.model.cell import Cell, RobotModel
from mbcacq.plan.planned import LoadedPlan
from mbcacq.quantities import from_degrees

LEAST_TRAVEL = 1e-4  # rad: an axis that moves less keeps its limits
T1_MM_S = 250.0  # a controller's reduced speed, ISO 10218-1


@dataclass(frozen=True)
class AxisLimits:
    """What the axes may do at most: speed, acceleration, jerk, each (n,) in rad/s, rad/s^2, rad/s^3."""

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray


def axis_limits(loaded: LoadedPlan) -> AxisLimits:
    """The model's limits; accelerations and jerks that it does not state follow from its speeds. Raises ConfigError without speeds."""
    model, planning = loaded.cell.robot, loaded.planning
    if model.speed is None:
        raise ConfigError(f"robot '{model.name}' has no speed limits and cannot be moved; give speed_deg_s of every axis in its file")
    acceleration = model.speed / planning.shortest_acceleration_time_s if model.acceleration is None else model.acceleration
    jerk = acceleration / planning.shortest_jerk_time_s if model.jerk is None else model.jerk
    return AxisLimits(model.speed, acceleration, jerk)


def requested_limits(loaded: LoadedPlan) -> AxisLimits:
    """What the plan asks for, whether the model allows it or not."""
    use, allowed = loaded.plan.robot, axis_limits(loaded)
    speed = use.speed * allowed.speed
    acceleration = speed / use.acceleration_time_s
    return AxisLimits(speed, acceleration, acceleration / use.jerk_time_s)


def motion_limits(loaded: LoadedPlan) -> MotionLimits:
    """What the plan asks for, within what the model allows: rad/s, rad/s^2, rad/s^3. Raises ConfigError without speeds."""
    use, allowed = loaded.plan.robot, axis_limits(loaded)
    acceleration = np.minimum(requested_limits(loaded).acceleration, allowed.acceleration)
    jerk = np.minimum(acceleration / use.jerk_time_s, allowed.jerk)
    chain, tolerance = loaded.cell.robot.chain, from_degrees(use.tolerance_deg)
    each = (
        tolerance * chain.by_kind(1.0, 0.5 * chain.reach) if chain.sliding else tolerance
    )  # a slide moves the scanner as far as joints do
    return MotionLimits(use.speed * allowed.speed, acceleration, jerk, each, use.settle_s)


def sweep_limits(loaded: LoadedPlan, start: np.ndarray, end: np.ndarray, speed_mm_s: float) -> MotionLimits:
    """Limits within the plan's under which all axes (n,) rad move in proportion, and the scanner at constant speed between its ramps."""
    limits, cell = motion_limits(loaded), loaded.cell
    T = cell.robot.chain.flange(np.array([start, end])) @ cell.T_flange_scanner
    travel = np.maximum(np.abs(end - start), LEAST_TRAVEL)
    length = float(np.linalg.norm(T[1, :3, 3] - T[0, :3, 3]))
    rate = min(speed_mm_s / max(length, 1.0), float((limits.speed / travel).min()))
    acceleration, jerk = float((limits.acceleration / travel).min()), float((limits.jerk / travel).min())
    return replace(limits, speed=rate * travel, acceleration=acceleration * travel, jerk=jerk * travel)


def check_target(target: np.ndarray, robot: RobotModel) -> None:
    """Last gate before a command. Raises SafetyStop for a target that is not finite or outside the joint limits."""
    outside = ~np.isfinite(target) | (target < robot.limits[:, 0]) | (target > robot.limits[:, 1])
    if outside.any():
        axis = int(np.argmax(outside))
        (low, high), unit = robot.shown(robot.limits.T)[:, axis], robot.unit(axis)
        at = f"{robot.axes[axis]} would go to {robot.shown(target)[axis]:.2f}{unit}"
        raise SafetyStop(f"{at}, outside its limits {low:g}..{high:g}{unit}; nothing was moved")


def arms_beyond(cell: Cell) -> np.ndarray:
    """(n,) mm: how far the scanner's origin can at most be from each axis, all links behind it stretched; 1 of a prismatic one."""
    chain = cell.robot.chain
    links = np.hypot(chain.a, chain.d)
    beyond = np.cumsum(links[::-1])[::-1] + float(np.linalg.norm(cell.T_flange_scanner[:3, 3]))
    return np.where(chain.prismatic, 1.0, beyond)


def longest_duration(travel: np.ndarray, limits: MotionLimits, arms: np.ndarray) -> float:
    """Generous bound (s, robot clock) on how long a motion may take before something is wrong. The travel (n,) rad is driven by the plan's
    limits or, if that takes longer, as in T1, no point faster than its reduced speed. arms: (n,) mm of ``arms_beyond``."""
    ramp = np.max(limits.speed / limits.acceleration + limits.acceleration / limits.jerk)
    planned = 3.0 * float(np.max(np.abs(travel) / limits.speed) + 2.0 * ramp)
    reduced = float(np.abs(travel) @ arms) / T1_MM_S
    return 10.0 + limits.settle_s + max(planned, reduced)
