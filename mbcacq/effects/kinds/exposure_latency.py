"""Pose and exposure that are not at one instant, where the arm still moved: each joint is off by its velocity times the latency."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, plain_effect
from mbcacq.effects.functions import DescribedPart, linear

NAME = "exposure_latency"


def candidates(context: Context) -> list[Candidate]:
    """One candidate for all joints; its coefficient, in s, is positive where the exposure comes after the reported angles."""
    if context.obs.velocity is None or np.abs(context.obs.velocity).max() < 1e-6:
        raise Missing("no velocities at the exposure recorded (qd1_deg_s..)")
    fastest = int(np.argmax(np.abs(np.nan_to_num(context.obs.velocity)).max(axis=0))) + 1
    parts = [DescribedPart("joint", i, 0, (linear(f"qd{i + 1}"),)) for i in range(context.n)]
    return [plain_effect(NAME, ["scanner"], f"qd{fastest}", parts, {"latency_s": 2e-3})]
