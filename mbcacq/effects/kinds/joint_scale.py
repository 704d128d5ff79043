"""A joint that turns or slides a little more or less than reported: encoder, gear ratio, lead of a screw. ``ratio`` is the excess over 1.

In motion the joint side moves by another ratio than the motor side reports.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, plain_effect, plain_report
from mbcacq.effects.functions import DescribedPart, linear
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals

NAME = "joint_scale"
# Wheels and encoder discs have whole numbers of teeth and lines, of which neither a rotary gear nor a direct drive can lose a share. A flat
# belt creeps by some 1e-3, a friction wheel slips, a screw has an error of its lead (ISO 3408-3: some 1e-4).
DRIVES = ("belt", "friction_wheel", "screw", "scaled_encoder")
DECLARED = Declaration(
    of_slides=True,
    drives=DRIVES,
    without_drive="the ratio of a gear is one of whole teeth (drive: belt, friction_wheel, screw or scaled_encoder permits the name)",
    challenge=Challenge(number=6, in_motion=8),
)


def candidates(context: Context) -> list[Candidate]:
    """For each joint that moves, the excess of its ratio over 1."""
    moved = [(i, context.axes[i], context.position(i)) for i in range(context.n) if np.ptp(context.obs.q[:, i]) > 0.02]
    return [plain_effect(NAME, [a], on, [DescribedPart("joint", i, 0, (linear(on),))], {f"{a}.ratio": 1e-4}) for i, a, on in moved]


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_joint":
        return []
    rows = [MotionRows((j,), lambda run, joint, _: run.q[:, [joint]]) for j in group.joints]
    at = zip(group.joints, rows, strict=True)
    return [Candidate(NAME, (group.axes[j],), f"q{group.tags[j]}", own, plain_report(f"{group.axes[j]}.ratio")) for j, own in at]
