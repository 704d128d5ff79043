"""Encoder or gear ratio: the joint side moves by another scale than the motor side says."""

from __future__ import annotations

from mbcacq.effects.motion.effect import Candidate, Group, Run, plain_report

NAME = "joint_scale"


def candidates(group: Group, runs: tuple[Run, ...]) -> list[Candidate]:
    if group.name != "q_joint":
        return []
    return [Candidate(NAME, (f"A{j + 1}",), f"q{j + 1}", (j,), lambda run, joint, _: run.q[:, [joint]],
                      plain_report(f"A{j + 1}.ratio")) for j in group.joints]
