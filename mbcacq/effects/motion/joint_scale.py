"""Encoder or gear ratio: the joint side moves by another scale than the motor side says."""

from __future__ import annotations

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "joint_scale"


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_joint":
        return []
    return [
        MotionCandidate(NAME, (f"A{j + 1}",), f"q{j + 1}", (j,), lambda run, joint, _: run.q[:, [joint]], plain_report(f"A{j + 1}.ratio"))
        for j in group.joints
    ]
