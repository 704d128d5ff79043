"""A candidate at its best hyper-parameter: an order, a moment, a time constant."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ScoredCandidate
from mbcacq.effects.effect import Candidate, Hyperparameter


def best_hyper(projected: CandidateScoring, candidate: Candidate) -> ScoredCandidate:
    """The candidate at the hyper-parameter that gains most; a preferred value is taken where it is as good."""
    hyper = candidate.hyper
    if hyper is None:
        return projected.test(candidate)
    if not candidate.separable:
        return max((projected.test(candidate, v) for v in hyper.values), key=lambda s: s.gain)
    gains = projected.scan(candidate)
    value, gain = float(hyper.values[np.argmax(gains)]), float(gains.max())
    if hyper.refine:
        value, gain = refine(projected, candidate, hyper, value, gain)
    if hyper.preferred:
        preferred = projected.scan(candidate, np.array(hyper.preferred))
        if preferred.max() > gain - 2 * np.log(independent_values(hyper, False) / independent_values(hyper, True)):
            value = hyper.preferred[int(preferred.argmax())]
    return projected.test(candidate, float(value))


def independent_values(hyper: Hyperparameter, preferred: bool) -> float:
    """Number of independent values, over the share of the prior that the preferred, or the other, ones have."""
    if not hyper.preferred:
        return hyper.independent
    return len(hyper.preferred) / OPTIONS.preferred_share if preferred else hyper.independent / (1 - OPTIONS.preferred_share)


def refine(projected: CandidateScoring, candidate: Candidate, hyper: Hyperparameter, value: float, gain: float) -> tuple[float, float]:
    """Value and gain after two rounds of a finer grid between the neighbours of the best value."""
    ordered = np.sort(hyper.values)
    j = int(np.searchsorted(ordered, value))
    low, high = ordered[max(j - 1, 0)], ordered[min(j + 1, len(ordered) - 1)]
    for _ in range(2):
        grid = np.linspace(low, high, 17)
        gains = projected.scan(candidate, grid)
        j = int(np.argmax(gains))
        if gains[j] > gain:
            value, gain = float(grid[j]), float(gains[j])
        low, high = grid[max(j - 1, 0)], grid[min(j + 1, 16)]
    return value, gain
