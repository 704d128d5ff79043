"""A spring or gas balancer at A2 that the rigid-body model leaves out.

Its torque depends on q2 alone. A spring between a point of the base and one of the link, a apart from the axis and b along the link,
has length l = sqrt(a^2 + b^2 - 2 a b cos(q - q0)) and pulls with k (l - l0): torque k a b sin(q - q0) (1 - l0 / l). The first part is a
sine, as mass; the second has harmonics, as nothing a rigid arm can do. Written here by harmonics.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "gravity_compensator"


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau" or 1 not in group.joints:
        return []
    names = [f"A2.{wave}{k}_Nm" for k in ("", "2") for wave in ("sin", "cos")]
    weight = max(float(np.abs(run.gravity[:, 1]).max()) for run in runs)  # what a balancer is there to balance
    return [
        MotionCandidate(NAME, ("A2",), "q2", (1,), _columns(1, 2), plain_report(*names), sigma=weight),
        MotionCandidate(
            NAME, ("A2",), "q2", (1,), _columns(3), plain_report("A2.sin3_Nm", "A2.cos3_Nm"), extends=True, tag="third", sigma=0.1 * weight
        ),
    ]


def _columns(*harmonics: int):
    def columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
        return np.stack([wave(k * run.q[:, joint]) for k in harmonics for wave in (np.sin, np.cos)], axis=1)

    return columns
