"""A spring or gas balancer at A2 that the rigid-body model leaves out.

Its torque depends on q2 alone. A rod between a point of the base, D apart from the axis, and one of the link, k along it, has the length
l = sqrt(D^2 + k^2 - 2 D k cos(delta)), delta = q2 - q0, and pulls with a force F(l): torque F D k sin(delta) / l. It carries the arm, so
q0 is near the angle at which the link stands upright. For springs and gas, which is compressed by less than half, F = F0 + F1 (l - l0).
The balancing form has F0, F1 and a shift of q0 as coefficients and tries the ratio k / D. The other form is a series of harmonics, for
mechanisms of another shape.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import (
    ChannelGroup,
    Columns,
    MotionCandidate,
    MotionSignals,
    Parameters,
    Report,
    available,
    plain_report,
    standard_deviations,
)
from mbcacq.geometry.gravity import upright_angle

NAME = "gravity_compensator"
THIRD_HARMONIC = 0.1  # prior sigma, as a share of that of the first two: the series of a spring converges as fast
LEVER_RATIOS = np.array([0.15, 0.25, 0.4])  # k / D of built balancers
UPRIGHT_SIGMA = np.radians(10.0)  # by how much q0 may differ from the upright angle
STEP = 1e-4  # rad, of a numerical derivative


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau" or 1 not in group.joints:
        return []
    weight = max(float(np.abs(available(run.gravity)[:, 1]).max()) for run in runs)  # the torque that a balancer has to balance
    first = plain_report("A2.sin_Nm", "A2.cos_Nm", "A2.sin2_Nm", "A2.cos2_Nm")
    third = plain_report("A2.sin3_Nm", "A2.cos3_Nm")
    out = [
        MotionCandidate(NAME, ("A2",), "q2", (1,), _harmonics(1, 2), first, sigma=weight, form="series"),
        MotionCandidate(NAME, ("A2",), "q2", (1,), _harmonics(3), third, extends=True, form="third", sigma=THIRD_HARMONIC * weight),
    ]
    robot = runs[0].robot
    upright = None if robot is None else upright_angle(robot.chain, robot.gravity)
    if upright is not None:
        sigma = (2.0 * weight, weight, 2.0 * weight * float(UPRIGHT_SIGMA))
        out.append(
            MotionCandidate(
                NAME,
                ("A2",),
                "q2",
                (1,),
                _balancing(upright),
                _balancing_report(upright),
                hyper=LEVER_RATIOS,
                positive=True,
                continuous=False,
                form="balancing",
                sigma=sigma,
                usual=True,
            )
        )
    return out


def _harmonics(*harmonics: int) -> Columns:
    def columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
        return np.stack([function(k * run.q[:, joint]) for k in harmonics for function in (np.sin, np.cos)], axis=1)

    return columns


def _constant_force(delta: np.ndarray, ratio: float) -> np.ndarray:
    """Torque of a constant force over its largest value, which is F0 k."""
    return np.sin(delta) / np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(delta))


def _balancing(upright: float) -> Columns:
    def columns(run: MotionSignals, joint: int, ratio: float | None) -> np.ndarray:
        assert ratio is not None
        delta = run.q[:, joint] - upright
        constant = _constant_force(delta, ratio)
        stretched = (np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(delta)) - (1.0 - ratio)) / (2.0 * ratio)
        turned = (_constant_force(delta - STEP, ratio) - _constant_force(delta + STEP, ratio)) / (2.0 * STEP)
        return np.stack([constant, constant * stretched, turned], axis=1)

    return columns


def _balancing_report(upright: float) -> Report:
    def report(c: np.ndarray, v: np.ndarray, ratio: float | None, _: float) -> Parameters:
        """The shift of q0 is the third coefficient over the first."""
        std = standard_deviations(v)
        gradient = np.array([-c[2] / c[0], 0.0, 1.0]) / c[0]
        shift_std = float(np.sqrt(max(gradient @ v @ gradient, 0.0)))
        return {
            "A2.preload_Nm": {"value": float(c[0]), "std": float(std[0])},
            "A2.stretched_Nm": {"value": float(c[1]), "std": float(std[1])},
            "A2.zero_deg": {"value": float(np.degrees(upright + c[2] / c[0])), "std": float(np.degrees(shift_std))},
        }

    return report
