"""The tool on the flange has another mass or centre of gravity than the cell describes; this acts in the torque of all joints."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, Parameters, available, standard_deviations

NAME = "payload"


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau" or any(run.payload is None for run in runs):
        return []
    return [MotionCandidate(NAME, ("mount",), "gravity_torque", group.joints, _columns, _report)]


def _columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return available(run.payload)[:, joint]


def _report(c: np.ndarray, v: np.ndarray, _: float | None, __: float) -> Parameters:
    """What must be added to the described payload: mass (kg) and first moment (kg mm, flange frame)."""
    std = standard_deviations(v)
    return {
        "added_mass_kg": {"value": float(c[0]), "std": float(std[0])},
        "added_moment_kg_mm": {"value": (1e3 * c[1:4]).tolist(), "std": (1e3 * std[1:4]).tolist()},
    }
