"""How finely the numbers of a recording are written, and what follows: rounded joint angles are noise, and points that the arm itself
explains to rounding were computed by it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations
from mbcacq.quantities import from_degrees, in_degrees

STEPS_DEG = (0.1, 0.01, 0.001)  # whole degrees are postures that somebody planned; finer steps are below what any arm repeats
_ON_GRID = 0.75  # share of the angles: means of cycles between two steps are off the grid, and by chance hardly any angle is on it
_LEAST_ANGLES = 20
_LEAST_DIGITS = 6  # different last digits: planned postures are often multiples of half a degree
_SLACK = 1e-4  # of a step: what a conversion to rad and back leaves
STEPS_MM = (1.0, 0.1, 0.01, 0.001)
ALIKE_MM = 0.005  # no arm is where its nominal kinematics say by so little


def joint_step(q: np.ndarray) -> float:
    """The step (rad) to which joint angles (P, n) rad were rounded; 0 where they are finer than anybody's joints repeat.

    Axes that never moved say nothing.
    """
    degrees = in_degrees(q[:, np.ptp(q, axis=0) > 0])
    if degrees.size < _LEAST_ANGLES or _on_grid(degrees, 1.0):
        return 0.0
    step = next((step for step in STEPS_DEG if _on_grid(degrees, step)), 0.0)
    varied = step and len(np.unique(np.rint(degrees / step) % 10)) >= _LEAST_DIGITS
    return float(from_degrees(step)) if varied else 0.0


def _on_grid(values: np.ndarray, step: float) -> bool:
    steps = values / step
    return bool(np.mean(np.abs(steps - np.rint(steps)) < _SLACK) > _ON_GRID)


def rounding_noise(step: float) -> float:
    """Standard deviation of what rounding to a step adds: uniform within half of it to either side."""
    return step / np.sqrt(12.0)


def with_joint_step(obs: Observations) -> Observations:
    """The observations, whose cell knows to what their joint angles were rounded."""
    robot = obs.cell.robot
    step = 0.0 if robot.of_flange_poses else joint_step(obs.q[:, ~robot.chain.prismatic])
    return replace(obs, cell=replace(obs.cell, joint_step=step)) if step else obs


def computed_by_the_arm(obs: Observations) -> float | None:
    """The rms (mm) by which the described arm itself gives the measured points, in its own base frame; None where that is more than the
    rounding of the numbers explains, as it is of points that an instrument measured.
    """
    robot = obs.cell.robot
    if obs.cell.measurement != TARGET_IN_BASE or robot.of_flange_poses:
        return None
    turns = ~robot.chain.prismatic
    on_flange = se3.apply_each(se3.inverse(robot.chain.flange(obs.q)), obs.pose, obs.xyz)
    off = on_flange - np.array([np.mean(on_flange[obs.ball == b], axis=0) for b in range(obs.ball.max() + 1)])[obs.ball]
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    step_mm = next((step for step in STEPS_MM if _on_grid(obs.xyz, step)), 0.0)
    rounding = np.hypot(
        np.sqrt(3) * rounding_noise(step_mm), rounding_noise(joint_step(obs.q[:, turns])) * np.linalg.norm(robot.chain.lever[turns])
    )
    return rms if rms < max(ALIKE_MM, 2.0 * rounding) else None


def rounding_sentence(step: float) -> str:
    return (
        f"The joint angles are rounded to {in_degrees(step):g}°, which adds {in_degrees(rounding_noise(step)):.2g}° of noise to "
        "each joint; it is counted as noise. Have them written with more decimals: on a KUKA set Precision to 6 at the ETHERNET object of "
        "the RSI context, elsewhere in the program or the table that the angles come from"
    )
