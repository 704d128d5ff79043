"""The tool on the flange has another mass or centre of gravity than the cell describes; this acts in the torque of all joints."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, Parameters, available, standard_deviations
from mbcacq.model.cell import RobotModel

NAME = "payload"
MASS_SHARE = 0.2  # prior sigma of an undescribed tool: robots carry up to a fifth of their own mass
LEVER_M, RADIUS_M = 0.2, 0.15  # prior sigma of its centre of gravity, and of its radius of gyration
LEAST_MASS_KG = 1.0


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau" or any(run.payload is None for run in runs):
        return []
    robot = runs[0].robot
    sigma = np.inf if robot is None else prior_sigma(robot)
    return [MotionCandidate(NAME, ("mount",), "gravity_torque", group.joints, _columns, _report, sigma=sigma, usual=True, tested=4)]


def prior_sigma(robot: RobotModel) -> tuple[float, ...]:
    """Prior standard deviations (10,) of the inertial parameters of an undescribed tool."""
    mass = max(LEAST_MASS_KG, MASS_SHARE * float(robot.mass.sum()))
    return (mass, *[mass * LEVER_M] * 3, *[mass * RADIUS_M**2] * 6)


def _columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return available(run.payload)[:, joint]


def _report(c: np.ndarray, v: np.ndarray, _: float | None, __: float) -> Parameters:
    """What must be added to the described payload: mass (kg) and first moment (kg mm, flange frame)."""
    std = standard_deviations(v)
    return {
        "added_mass_kg": {"value": float(c[0]), "std": float(std[0])},
        "added_moment_kg_mm": {"value": (1e3 * c[1:4]).tolist(), "std": (1e3 * std[1:4]).tolist()},
    }
