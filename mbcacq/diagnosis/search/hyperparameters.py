"""A candidate at its best hyper-parameter: an order, a moment, a time constant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ScoredCandidate
from mbcacq.effects.effect import Candidate, Hyperparameter

REFINED = 1.3  # times as much as on the grid a candidate may gain between its values
PREFERRED = 0.8  # share of a candidate's chances that its preferred values have


def best_hyper(
    screen: CandidateScoring, candidate: Candidate, least: Callable[[float | None], float] = lambda hyper: -np.inf
) -> ScoredCandidate | None:
    """The candidate at the hyper-parameter that gains most; a preferred value is taken where it is as good.

    least: what must be gained at a value; None where no value gains so much.
    """
    hyper = candidate.hyper
    if hyper is None:
        return enough(screen.test(candidate), least)
    if not candidate.separable:
        return enough(max((screen.test(candidate, v) for v in hyper.values), key=lambda s: s.gain), least)
    curve = screen.scan(candidate)
    value, gain = hyper.values[np.argmax(curve)], curve.max()
    if REFINED * gain < min(least(v) for v in (value, *hyper.preferred[:1])):
        return None
    if hyper.refine:
        value, gain = refine(screen, candidate, value, gain)
    if hyper.preferred:
        expected = screen.scan(candidate, np.array(hyper.preferred))
        if expected.max() > gain - 2 * np.log(values(hyper, False) / values(hyper, True)):
            value = hyper.preferred[int(expected.argmax())]
    return enough(screen.test(candidate, float(value)), least)


def enough(scored: ScoredCandidate, least: Callable[[float | None], float]) -> ScoredCandidate | None:
    return scored if scored.gain > least(scored.hyper) else None


def values(hyper: Hyperparameter, preferred: bool) -> float:
    """Number of independent values, over the share of the prior that the preferred, or the other, ones have."""
    if not hyper.preferred:
        return hyper.independent
    return len(hyper.preferred) / PREFERRED if preferred else hyper.independent / (1 - PREFERRED)


def refine(screen: CandidateScoring, candidate: Candidate, value: float, gain: float) -> tuple[float, float]:
    """Two rounds of a finer grid between the neighbours of the best value."""
    ordered = np.sort(candidate.hyper.values)
    j = int(np.searchsorted(ordered, value))
    low, high = ordered[max(j - 1, 0)], ordered[min(j + 1, len(ordered) - 1)]
    for _ in range(2):
        grid = np.linspace(low, high, 17)
        curve = screen.scan(candidate, grid)
        j = int(np.argmax(curve))
        if curve[j] > gain:
            value, gain = float(grid[j]), float(curve[j])
        low, high = grid[max(j - 1, 0)], grid[min(j + 1, 16)]
    return value, gain
