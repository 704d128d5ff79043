"""Uncertainty of the moment of a sudden change, of the torque at which a gearbox becomes stiff, of a time constant and of a slow order:
what the likelihood of all other values says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import log_factors
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import covariates
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import BREAKPOINT, FADING, MOMENT, ORDER, Candidate, HyperEstimate, ParameterEstimate, Parameters

FAST = 3.0  # periods over the travel, from which an order is determined whatever the amplitude
LOWEST_ORDER = 1.0  # an error of a joint repeats after a turn at the latest
SLOWER = 5.0  # times the longest time constant that is sought: what fades more slowly is a straight line in any recording

BREAKPOINT_REACH = float(np.log(3.0))  # of the logarithm of a torque: a third to three times what was found
SHARPEST = 1e-4  # of the same: below, no model of a gearbox is as exact as that


def with_moment_uncertainty(hypothesis: Hypothesis, member: Member) -> Candidate:
    """The candidate of a member, which reports its moment, torque or time constant with the standard deviation over all others."""
    candidate, along = member.candidate, np.zeros(())
    if candidate.hyper is None or not candidate.components or member.hyper is None:
        return candidate
    name, kind = candidate.hyper.name, candidate.hyper.kind
    if kind == MOMENT:
        between = 1 / np.sqrt(12)  # it happened anywhere between two poses
        std = float(np.hypot(between, spread(hypothesis, member, candidate.hyper.values)))
    elif kind == BREAKPOINT:
        std = spread_of_breakpoint(hypothesis, member)
    elif kind == FADING:
        std, along = uncertain_fading(hypothesis, member)
    elif kind == ORDER:
        return with_uncertain_order(hypothesis, member)
    else:
        return candidate

    def report(c: np.ndarray, v: np.ndarray, found: HyperEstimate) -> Parameters:
        whole = candidate.report(c, v + along, found)
        return {k: ParameterEstimate(p.value, std) if k.rpartition(".")[2] == name else p for k, p in whole.items()}

    return replace(candidate, report=report)


def uncertain_fading(hypothesis: Hypothesis, member: Member) -> tuple[float, np.ndarray]:
    """Standard deviation of the time constant of something that fades with time, and (k, k) covariance that this adds to its size. Where
    the recording is short against the time constant, only the rate at the beginning is determined: then the size goes with the time
    constant, and both are as uncertain as all that are possible differ.
    """
    candidate, found = member.candidate, member.hyper
    assert candidate.hyper is not None, "only asked of effects with a time constant"
    assert found is not None, "only asked of effects with a time constant"
    values = np.geomspace(candidate.hyper.values.min(), SLOWER * candidate.hyper.values.max(), OPTIONS.fine)
    others = with_others(hypothesis, member)
    probability = likelihood(others, candidate, values)
    there = hypothesis.solved
    reported = there.coefficients[there.slices()[hypothesis.members.index(member)]]
    away = sizes_with(others, member, values) - reported
    return float(np.sqrt(probability @ (values - found) ** 2)), (away * probability[:, None]).T @ away


def with_uncertain_order(hypothesis: Hypothesis, member: Member) -> Candidate:
    """The candidate of a periodic error. Its order is as uncertain as the orders that the travel cannot tell apart, and each reported size
    as uncertain as it differs between them: over less than two periods the amplitude goes with the order.
    """
    candidate, found = member.candidate, member.hyper
    assert candidate.hyper is not None, "only asked of periodic effects"
    assert found is not None, "only asked of periodic effects"
    span = float(np.ptp(covariates(hypothesis.point.linear).value(candidate.depends_on)))
    resolution = 2 * np.pi / max(span, 1e-9)
    if found > FAST * resolution:  # the order is determined by itself, and what it reports says how well
        return candidate
    values = np.linspace(max(LOWEST_ORDER, found - resolution), found + resolution, OPTIONS.fine)
    others = with_others(hypothesis, member)
    probability = likelihood(others, candidate, values)
    nothing = np.zeros((candidate.k, candidate.k))
    sizes = sizes_with(others, member, values)
    there = [candidate.parameters(size, nothing, float(v)) for size, v in zip(sizes, values, strict=True)]
    name = candidate.hyper.name

    def spread_of(key: str, value: float) -> float:
        away = np.array([float(np.max(one[key].value)) for one in there]) - value
        away = (away + 180.0) % 360.0 - 180.0 if key.endswith("phase_deg") else away
        return float(np.sqrt(probability @ away**2))

    def report(c: np.ndarray, v: np.ndarray, order: HyperEstimate) -> Parameters:
        whole = candidate.report(c, v, order)
        own = {key: (float(np.max(p.value)), float(np.max(p.std))) for key, p in whole.items()}
        wide = {
            key: max(spread_of(key, value), std) if key.rpartition(".")[2] == name else np.hypot(std, spread_of(key, value))
            for key, (value, std) in own.items()
        }
        return {key: ParameterEstimate(value, float(wide[key])) for key, (value, _) in own.items()}

    return replace(candidate, report=report)


def with_others(hypothesis: Hypothesis, member: Member) -> CandidateScoring:
    """The problem with the other effects of a set in place, each at its most probable size."""
    return hypothesis.point.conditioned([m for m in hypothesis.members if m is not member])


def sizes_with(others: CandidateScoring, member: Member, values: np.ndarray) -> np.ndarray:
    """(H, k) coefficients of a member, had its hyper-parameter each of these values (H,), of whatever size that asks for."""
    S, b = others.normal_matrices(member.candidate, values)
    sigma = member.sizes[-1] * member.candidate.typical
    return np.linalg.solve(S + np.diag(sigma**-2.0), b[:, :, None])[:, :, 0]


def spread(hypothesis: Hypothesis, member: Member, values: np.ndarray) -> float:
    """Root mean square distance of these values (H,) of the hyper-parameter from the member's, by their likelihood."""
    assert member.hyper is not None, "only asked of effects with a hyper-parameter"
    probability = likelihood(with_others(hypothesis, member), member.candidate, values)
    return float(np.sqrt(probability @ (values - member.hyper) ** 2))


def spread_of_breakpoint(hypothesis: Hypothesis, member: Member) -> float:
    """The same of torques about the member's, over a range that narrows until the values in it resolve how sharply it is known."""
    assert member.hyper is not None, "only asked of effects with a hyper-parameter"
    reach = BREAKPOINT_REACH
    while True:
        std = spread(hypothesis, member, member.hyper * np.exp(np.linspace(-reach, reach, OPTIONS.fine)))
        step = member.hyper * 2 * reach / (OPTIONS.fine - 1)
        if std >= step or reach < SHARPEST:
            return max(std, step) if reach < SHARPEST else std
        reach /= 4.0  # four steps on either side, within which what is sharper lies


def likelihood(others: CandidateScoring, candidate: Candidate, values: np.ndarray) -> np.ndarray:
    """(H,) probability of each of these values of an effect's hyper-parameter beside the others, all being as probable before."""
    logs = log_factors(others, candidate, values)
    return np.exp(logs - np.logaddexp.reduce(logs))
