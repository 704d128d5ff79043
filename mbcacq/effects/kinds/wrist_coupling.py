"""Motion of one wrist axis that leaks into another, as through hollow shafts whose compensation is wrong.

In motion it appears in the joint-side encoder of the other axis.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, plain_effect, plain_report
from mbcacq.effects.functions import DescribedPart, linear
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals

NAME = "wrist_coupling"
DECLARED = Declaration(between_locations=True, challenge=Challenge(number=7, in_motion=9))
FIRST_WRIST_JOINT, JOINTS = 3, 6


def candidates(context: Context) -> list[Candidate]:
    """For each ordered pair of wrist axes, the angle of the second by that of the first."""
    first = max(context.n - 3, 0)
    pairs = [(i, j) for i in range(first, context.n) for j in range(first, context.n) if i != j and np.ptp(context.obs.q[:, i]) > 0.02]
    parts = {(i, j): [DescribedPart("joint", j, 0, (linear(f"q{context.tags[i]}"),))] for i, j in pairs}
    at = context.axes
    return [plain_effect(NAME, [at[i], at[j]], f"q{context.tags[i]}", moved, {"ratio": 1e-4}) for (i, j), moved in parts.items()]


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_joint" or runs[0].q.shape[1] != JOINTS:
        return []
    wrist = range(FIRST_WRIST_JOINT, JOINTS)
    pairs = [(j, other) for j in group.joints if j in wrist for other in wrist if other != j]
    rows = {other: (lambda run, joint, _, other=other: run.q[:, [other]]) for other in wrist}
    return [
        Candidate(NAME, (group.axes[k], group.axes[j]), f"q{group.tags[k]}", MotionRows((j,), rows[k]), plain_report("ratio"))
        for j, k in pairs
    ]
