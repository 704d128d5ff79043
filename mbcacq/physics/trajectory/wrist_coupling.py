"""Motion of one wrist axis leaking into another one's encoder or following."""

from __future__ import annotations

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, value

NAME = "wrist_coupling"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    n = runs[0].q.shape[1]
    if channel.name not in ("q_joint", "q_set") or n != 6 or channel.joint < 3:
        return []
    out = []
    for other in range(3, n):
        if other != channel.joint:
            name = f"{channel.axis}_from_A{other + 1}.ratio"
            out.append(Candidate(NAME, (f"A{other + 1}", channel.axis), f"q{other + 1}",
                                 lambda run, joint, _, other=other: run.q[:, [other]],
                                 lambda c, v, _, name=name: value(name, c[0], v[0, 0])))
    return out
