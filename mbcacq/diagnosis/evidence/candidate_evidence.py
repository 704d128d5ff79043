"""Evidence of every candidate as a further effect: averaged over sizes and over the values of its hyper-parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import log_bayes_factors
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member, possible_sizes
from mbcacq.effects.effect import Candidate

# A candidate at its most probable hyper-parameter, with its log Bayes factor averaged over sizes and hyper-parameter.
Scored = tuple[float, Member]


def evidence_of_candidates(projected: CandidateScoring, candidates: list[Candidate]) -> list[Scored]:
    """All candidates beyond geometry and what the problem is conditioned on."""
    out = fixed_candidates(projected, candidates)
    return out + [scanned_candidate(projected, c) for c in candidates if c.components]


def evidence_of_candidate(projected: CandidateScoring, candidate: Candidate) -> Scored:
    """One candidate beyond geometry and what the problem is conditioned on."""
    return evidence_of_candidates(projected, [candidate])[0]


def fixed_candidates(projected: CandidateScoring, candidates: list[Candidate]) -> list[Scored]:
    """Scores of the candidates whose hyper-parameter has few values, all in one product."""
    chosen = [c for c in candidates if not c.components]
    if not chosen:
        return []
    fixed, X, blocks = projected.batch(candidates)
    logs = np.zeros(len(fixed.entries))
    absorbed = (projected.conditioned.T @ X).T
    for (entries, columns), (S, b) in zip(fixed.sizes, blocks, strict=True):
        gone = absorbed[columns]
        typical = np.array([fixed.entries[e][0].typical for e in entries])
        A = (S - gone @ np.swapaxes(gone, 1, 2)) * (typical[:, :, None] * typical[:, None])
        a = (b - gone @ projected.along) * typical
        kinds = [(fixed.entries[e][0].positive, fixed.entries[e][0].least_size) for e in entries]
        for positive, least in set(kinds):
            mine = np.array([kind == (positive, least) for kind in kinds])
            logs[entries[mine]] = log_bayes_factors(A[mine], a[mine], np.array(possible_sizes(least)), positive)
    ends = np.cumsum([1 if c.hyper is None else len(c.hyper.values) for c in chosen])
    return [averaged(c, each) for c, each in zip(chosen, np.split(logs, ends[:-1]), strict=True)]


def evidence_of_one(projected: CandidateScoring, candidate: Candidate, hyper: float | None = None) -> Scored:
    """A candidate at one value of its hyper-parameter, or without one."""
    return float(log_factors(projected, candidate, [hyper])[0]), Member(candidate, hyper)


def averaged(candidate: Candidate, logs: np.ndarray) -> Scored:
    """Over the values of a hyper-parameter, with log Bayes factors (H,)."""
    if candidate.hyper is None:
        return float(logs[0]), Member(candidate, None)
    weighted = logs + log_weights(candidate, candidate.hyper.values)
    total, best = float(np.logaddexp.reduce(weighted)), int(weighted.argmax())
    return total, Member(candidate, float(candidate.hyper.values[best]), total - float(logs[best]))


def log_weights(candidate: Candidate, values: np.ndarray) -> np.ndarray:
    """(H,) log prior probability of each value of a grid."""
    assert candidate.hyper is not None, "only asked for candidates with a hyper-parameter"
    preferred = np.isin(values, candidate.hyper.preferred)
    if not preferred.any():
        return np.full(len(values), -np.log(len(values)))
    weight = np.where(preferred, OPTIONS.preferred / preferred.sum(), 0.0) + (1 - OPTIONS.preferred) / len(values)
    return np.log(weight)


def log_factors(projected: CandidateScoring, candidate: Candidate, values: Sequence[float | None] | np.ndarray) -> np.ndarray:
    """(H,) log Bayes factors of a candidate at values of its hyper-parameter."""
    S, b = projected.normal_matrices(candidate, values)
    t = candidate.typical
    return log_bayes_factors(S * np.outer(t, t), b * t, np.array(possible_sizes(candidate.least_size)), candidate.positive)


def scanned_candidate(projected: CandidateScoring, candidate: Candidate) -> Scored:
    """A candidate whose hyper-parameter is scanned over its grid, and between the values of the grid about the best one."""
    hyper = candidate.hyper
    assert hyper is not None, "a candidate with components has a hyper-parameter"
    logs = log_factors(projected, candidate, hyper.values)
    coarse = averaged(candidate, logs)
    if not hyper.refine or logs.max() < OPTIONS.resolved:
        return coarse
    grid = np.sort(hyper.values)
    j = int(np.searchsorted(grid, hyper.values[int(logs.argmax())]))
    low, high = float(grid[max(j - 1, 0)]), float(grid[min(j + 1, len(grid) - 1)])
    mass, best = refined(projected, candidate, low, high)
    continuous = mass + float(np.log(((1 - OPTIONS.preferred) if hyper.preferred else 1.0) / len(grid)))
    total = max(coarse[0], continuous)
    if hyper.preferred and coarse[1].hyper in hyper.preferred and coarse[0] > continuous:
        return coarse
    return total, Member(candidate, best[0], total - best[1])


def refined(projected: CandidateScoring, candidate: Candidate, low: float, high: float) -> tuple[float, tuple[float, float]]:
    """Log of the integral of the Bayes factor from low to high, in units of half that range, and the best value with its log factor."""
    step = (high - low) / 2
    mass, best = -np.inf, (low, -np.inf)
    for _ in range(OPTIONS.rounds):
        fine = np.linspace(low, high, OPTIONS.fine)
        peak = log_factors(projected, candidate, fine)
        j = int(peak.argmax())
        before, after = max(j - 1, 0), min(j + 1, OPTIONS.fine - 1)
        mass = float(np.logaddexp.reduce(peak)) + float(np.log((high - low) / (OPTIONS.fine - 1) / step))
        best = float(fine[j]), float(peak[j])
        if peak[j] - min(peak[before], peak[after]) < OPTIONS.resolved:
            break
        low, high = float(fine[before]), float(fine[after])
    return mass, best
