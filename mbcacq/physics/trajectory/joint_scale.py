"""Encoder or gear ratio: the joint side moves by another scale than the motor side says."""

from __future__ import annotations

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, value

NAME = "joint_scale"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_joint":
        return []
    return [Candidate(NAME, (channel.axis,), f"q{channel.joint + 1}", lambda run, joint, _: run.q[:, [joint]],
                      lambda c, v, _: value(f"{channel.axis}.ratio", c[0], v[0, 0]))]
