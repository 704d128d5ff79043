"""A spring or gas balancer at A2 that the rigid-body model leaves out.

Its torque depends on q2 alone. A spring between a point of the base and one of the link, a apart from the axis and b along the link,
has length l = sqrt(a^2 + b^2 - 2 a b cos(q - q0)) and pulls with k (l - l0): torque k a b sin(q - q0) (1 - l0 / l). The first part is a
sine, as that of a mass; the second has harmonics, as no rigid arm has. The effect is a series of harmonics.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, Columns, MotionCandidate, MotionSignals, available, plain_report

NAME = "gravity_compensator"
THIRD_HARMONIC = 0.1  # prior sigma, as a share of that of the first two: the series of a spring converges as fast


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau" or 1 not in group.joints:
        return []
    weight = max(float(np.abs(available(run.gravity)[:, 1]).max()) for run in runs)  # the torque that a balancer has to balance
    first = plain_report("A2.sin_Nm", "A2.cos_Nm", "A2.sin2_Nm", "A2.cos2_Nm")
    third = plain_report("A2.sin3_Nm", "A2.cos3_Nm")
    return [
        MotionCandidate(NAME, ("A2",), "q2", (1,), _columns(1, 2), first, sigma=weight),
        MotionCandidate(NAME, ("A2",), "q2", (1,), _columns(3), third, extends=True, form="third", sigma=THIRD_HARMONIC * weight),
    ]


def _columns(*harmonics: int) -> Columns:
    def columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
        return np.stack([function(k * run.q[:, joint]) for k in harmonics for function in (np.sin, np.cos)], axis=1)

    return columns
