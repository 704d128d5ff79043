"""Pose and exposure that are not at one instant, where the arm still moved: each joint is off by its velocity times the latency."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, scalar_report

NAME = "exposure_latency"


def candidates(context: Context) -> list[Candidate]:
    """One candidate for all joints; its coefficient, in s, is positive where the exposure comes after the reported angles."""
    if context.obs.velocity is None or np.abs(context.obs.velocity).max() < 1e-6:
        raise Missing("no velocities at the exposure recorded (qd1_deg_s..)")
    velocity = np.nan_to_num(context.obs.velocity)
    fastest = int(np.argmax(np.abs(velocity).max(axis=0))) + 1
    parts = [Part("joint", i, 0, velocity[:, i : i + 1]) for i in range(context.n)]
    return [Candidate(NAME, ("scanner",), f"qd{fastest}", lambda _: parts, scalar_report("latency_s"), np.array([2e-3]))]
