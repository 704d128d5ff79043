"""Uncertainty of the moment of a sudden change, and of the torque at which a gearbox becomes stiff: what the likelihood of all other
values says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import log_factors
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, conditioned
from mbcacq.effects.effect import Candidate, ParameterEstimate, Parameters
from mbcacq.effects.pose import lost_motion, steps

BETWEEN_POSES = 0.5  # poses
FINE = 61  # torques about the found one, from a third to three times as much


def with_moment_uncertainty(hypothesis: Hypothesis, member: Member) -> Candidate:
    """The candidate of a member, which reports its moment, or its torque, with the standard deviation over all others."""
    candidate = member.candidate
    if candidate.hyper is None or not candidate.separable or member.hyper is None:
        return candidate
    name = candidate.hyper.name
    if name == steps.NAME:
        std = float(np.hypot(BETWEEN_POSES, spread(hypothesis, member, candidate.hyper.values)))
    elif name == lost_motion.BREAKPOINT:
        std = spread(hypothesis, member, member.hyper * np.geomspace(1 / 3, 3, FINE))
    else:
        return candidate

    def report(c: np.ndarray, v: np.ndarray, rank: float | None) -> Parameters:
        whole = candidate.report(c, v, rank)
        return {k: ParameterEstimate(p.value, std) if k.rpartition(".")[2] == name else p for k, p in whole.items()}

    return replace(candidate, report=report)


def spread(hypothesis: Hypothesis, member: Member, values: np.ndarray) -> float:
    """Root mean square distance of these values (H,) of the hyper-parameter from the member's, by their likelihood."""
    assert member.hyper is not None, "only asked of effects with a hyper-parameter"
    others = conditioned(hypothesis.point, [m for m in hypothesis.members if m is not member])
    logs = log_factors(others, member.candidate, values)
    probability = np.exp(logs - np.logaddexp.reduce(logs))
    return float(np.sqrt(probability @ (values - member.hyper) ** 2))
