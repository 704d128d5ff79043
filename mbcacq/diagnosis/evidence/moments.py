"""Uncertainty of the moment of a sudden change: what the likelihood of all other moments says, not only that it lies between two poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import log_factors
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, conditioned
from mbcacq.effects.effect import Candidate, ParameterEstimate, Parameters
from mbcacq.effects.pose import steps

BETWEEN_POSES = 0.5  # poses


def with_moment_uncertainty(hypothesis: Hypothesis, member: Member) -> Candidate:
    """The candidate of a member, which reports its moment with the standard deviation over all moments; others as they are."""
    candidate = member.candidate
    if candidate.hyper is None or candidate.hyper.name != steps.NAME or not candidate.separable:
        return candidate
    std = moment_std(hypothesis, member)

    def report(c: np.ndarray, v: np.ndarray, rank: float | None) -> Parameters:
        whole = candidate.report(c, v, rank)
        return {k: ParameterEstimate(p.value, std) if k.rpartition(".")[2] == steps.NAME else p for k, p in whole.items()}

    return replace(candidate, report=report)


def moment_std(hypothesis: Hypothesis, member: Member) -> float:
    """Poses."""
    hyper = member.candidate.hyper
    assert hyper is not None, "only asked of a change at a moment"
    assert member.hyper is not None, "a change has a moment"
    others = conditioned(hypothesis.point, [m for m in hypothesis.members if m is not member])
    logs = log_factors(others, member.candidate, hyper.values)
    probability = np.exp(logs - np.logaddexp.reduce(logs))
    return float(np.hypot(BETWEEN_POSES, np.sqrt(probability @ (hyper.values - member.hyper) ** 2)))
