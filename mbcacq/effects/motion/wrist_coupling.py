"""Rotation of one wrist axis that appears in the encoder of another one."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, Columns, MotionCandidate, MotionSignals, plain_report

NAME = "wrist_coupling"
FIRST_WRIST_JOINT, JOINTS = 3, 6


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_joint" or runs[0].q.shape[1] != JOINTS:
        return []
    wrist = range(FIRST_WRIST_JOINT, JOINTS)
    pairs = [(j, other) for j in group.joints if j in wrist for other in wrist if other != j]
    return [
        MotionCandidate(
            NAME, (f"A{other + 1}", f"A{j + 1}"), f"q{other + 1}", (j,), _columns(other), plain_report(f"A{j + 1}_from_A{other + 1}.ratio")
        )
        for j, other in pairs
    ]


def _columns(other: int) -> Columns:
    def columns(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
        return run.q[:, [other]]

    return columns
