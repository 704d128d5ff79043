"""Scale of an encoder or gear ratio: the joint side moves by another ratio than the motor side reports."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "joint_scale"


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_joint":
        return []
    return [MotionCandidate(NAME, (f"A{j + 1}",), f"q{j + 1}", (j,), _columns, plain_report(f"A{j + 1}.ratio")) for j in group.joints]


def _columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return run.q[:, [joint]]
