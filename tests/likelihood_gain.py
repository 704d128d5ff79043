"""What a candidate gains in chi2 as the one further effect, at a value of its hyper-parameter (an order, a moment) or at the best one.

A likelihood-ratio test asks for it, and the fit of an effect whose name and location are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import eigenvalues, prior_weight
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate, Hyperparameter

SMALLEST_EIGENVALUE = 1e-6  # of a normal matrix in units of its columns' squares; less is what geometry absorbs, up to rounding
FINE = 17  # values of a finer grid


@dataclass(frozen=True)
class CandidateGain:
    """A candidate with k coefficients at one value of its hyper-parameter, and its gain in chi2."""

    candidate: Candidate
    hyper: float | None
    gain: float
    k: int


def gain_at(projected: CandidateScoring, candidate: Candidate, hyper: float | None = None) -> CandidateGain:
    """Beyond geometry and what the problem is conditioned on."""
    X, S, b = projected.candidate_products(candidate, hyper)
    absorbed = projected.conditioned.T @ X
    gain = gains_of_blocks((S - absorbed.T @ absorbed)[None], (b - absorbed.T @ projected.along)[None], prior_weight(candidate))
    return CandidateGain(candidate, hyper, float(gain[0]), len(b))


def gains(projected: CandidateScoring, candidate: Candidate, values: np.ndarray) -> np.ndarray:
    """(H,) of a candidate with components at values (H,) of its hyper-parameter."""
    return gains_of_blocks(*projected.normal_matrices(candidate, values), prior_weight(candidate))


def gains_of_blocks(S: np.ndarray, b: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(H,) of normal matrices (H, k, k) and right-hand sides (H, k) with the prior inverse variance (k,) of the coefficients; directions
    that geometry absorbs are held at zero.
    """
    S = S + np.diag(weight)
    size = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 1e-300))
    value, along = eigenvalues(S / (size[:, :, None] * size[:, None, :]), b / size)
    return np.sum(np.where(value > SMALLEST_EIGENVALUE, along**2 / np.maximum(value, SMALLEST_EIGENVALUE), 0.0), axis=1)


def best_hyper(projected: CandidateScoring, candidate: Candidate) -> CandidateGain:
    """The candidate at the hyper-parameter that gains most; a preferred value is taken where it is as good."""
    hyper = candidate.hyper
    if hyper is None:
        return gain_at(projected, candidate)
    if not candidate.components:
        return max((gain_at(projected, candidate, v) for v in hyper.values), key=lambda s: s.gain)
    coarse = gains(projected, candidate, hyper.values)
    value, gain = float(hyper.values[np.argmax(coarse)]), float(coarse.max())
    if hyper.refine:
        value, gain = refine(projected, candidate, hyper, value, gain)
    if hyper.preferred:
        preferred = gains(projected, candidate, np.array(hyper.preferred))
        if preferred.max() > gain - 2 * np.log(independent_values(hyper, False) / independent_values(hyper, True)):
            value = hyper.preferred[int(preferred.argmax())]
    return gain_at(projected, candidate, float(value))


def independent_values(hyper: Hyperparameter, preferred: bool) -> float:
    """Number of independent values, over the share of the prior that the preferred, or the other, ones have."""
    if not hyper.preferred:
        return hyper.independent
    return len(hyper.preferred) / OPTIONS.preferred if preferred else hyper.independent / (1 - OPTIONS.preferred)


def refine(projected: CandidateScoring, candidate: Candidate, hyper: Hyperparameter, value: float, gain: float) -> tuple[float, float]:
    """Value and gain after two rounds of a finer grid between the neighbours of the best value."""
    ordered = np.sort(hyper.values)
    j = int(np.searchsorted(ordered, value))
    low, high = ordered[max(j - 1, 0)], ordered[min(j + 1, len(ordered) - 1)]
    for _ in range(2):
        grid = np.linspace(low, high, FINE)
        fine = gains(projected, candidate, grid)
        j = int(np.argmax(fine))
        if fine[j] > gain:
            value, gain = float(grid[j]), float(fine[j])
        low, high = grid[max(j - 1, 0)], grid[min(j + 1, FINE - 1)]
    return value, gain
