"""Pose and exposure not at one instant, where the arm still moved."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, scalar_report

NAME = "exposure_latency"


def candidates(s: Context) -> list[Candidate]:
    if s.obs.velocity is None or np.abs(s.obs.velocity).max() < 1e-6:
        raise Missing("no velocities at the exposure recorded (qd1_deg_s..)")
    velocity = np.nan_to_num(s.obs.velocity)
    fastest = int(np.argmax(np.abs(velocity).max(axis=0))) + 1
    parts = [Part("joint", i, 0, velocity[:, i : i + 1]) for i in range(s.n)]
    return [Candidate(NAME, ("scanner",), f"qd{fastest}", lambda _: parts, scalar_report("latency_s"), np.array([2e-3]))]
