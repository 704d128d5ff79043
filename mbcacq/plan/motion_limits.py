"""How fast the axes may move, where they may go, and how long a motion may take."""

from __future__ import annotations

import numpy as np

from mbcacq.devices import MotionLimits, SafetyStop
from mbcacq.model.cell import Cell
from mbcacq.plan.planned import LoadedPlan

T1_MM_S = 250.0  # a controller's reduced speed, ISO 10218-1


def motion_limits(loaded: LoadedPlan) -> MotionLimits:
    """The plan's speed limits applied to the model's: rad/s, rad/s^2, rad/s^3."""
    use, model = loaded.plan.robot, loaded.cell.robot
    fastest = model.speed if model.speed is not None else np.full(model.n, loaded.planning.assumed_safe_speed)
    speed = use.speed * fastest
    acceleration = speed / use.acceleration_time_s
    if model.acceleration is not None:
        acceleration = np.minimum(acceleration, model.acceleration)
    return MotionLimits(speed, acceleration, acceleration / use.jerk_time_s, np.radians(use.tolerance_deg), use.settle_s)


def check_target(target: np.ndarray, limits: np.ndarray) -> None:
    """Last gate before a command. Raises SafetyStop for a target that is not finite or outside the joint limits (n, 2) rad."""
    outside = ~np.isfinite(target) | (target < limits[:, 0]) | (target > limits[:, 1])
    if outside.any():
        axis = int(np.argmax(outside))
        low, high = np.degrees(limits[axis])
        angle = np.degrees(target[axis])
        raise SafetyStop(f"A{axis + 1} would go to {angle:.2f} deg, outside its limits {low:g}..{high:g} deg; nothing was moved")


def arms_beyond(cell: Cell) -> np.ndarray:
    """(n,) mm: how far the scanner's origin can at most be from each axis, all links behind it stretched."""
    chain = cell.robot.chain
    links = np.hypot(chain.a, chain.d)
    return np.cumsum(links[::-1])[::-1] + float(np.linalg.norm(cell.T_flange_scanner[:3, 3]))


def longest_duration(travel: np.ndarray, limits: MotionLimits, arms: np.ndarray) -> float:
    """Generous bound (s, robot clock) on how long a motion may take before something is wrong: travel (n,) rad by the plan's limits, or
    where that takes longer as a controller drives in T1, no point faster than its reduced speed. arms: (n,) mm of ``arms_beyond``."""
    ramp = np.max(limits.speed / limits.acceleration + limits.acceleration / limits.jerk)
    planned = 3.0 * float(np.max(np.abs(travel) / limits.speed) + 2.0 * ramp)
    reduced = float(np.abs(travel) @ arms) / T1_MM_S
    return 10.0 + limits.settle_s + max(planned, reduced)
