"""Motion of one wrist axis leaking into another one's encoder."""

from __future__ import annotations

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "wrist_coupling"


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    n = runs[0].q.shape[1]
    if group.name != "q_joint" or n != 6:
        return []
    return [
        MotionCandidate(
            NAME,
            (f"A{other + 1}", f"A{j + 1}"),
            f"q{other + 1}",
            (j,),
            lambda run, joint, _, other=other: run.q[:, [other]],
            plain_report(f"A{j + 1}_from_A{other + 1}.ratio"),
        )
        for j in group.joints
        if j >= 3
        for other in range(3, n)
        if other != j
    ]
