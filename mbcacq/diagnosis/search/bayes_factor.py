"""Bayes factor of coefficients of unknown size: the ratio of marginal likelihoods with them and without, of one effect and of a set.

Coefficients are normal with standard deviations s times typical; each size s of a few is equally probable beforehand. With A = D X'PX D and
a = D X'Pr (D: typical sizes), log BF(s) = 1/2 (s^2 a'(I + s^2 A)^-1 a - ln|I + s^2 A|). Without an effect its expectation is one, whatever
the columns, so averages over blocks (with prior shares) may be compared. An average of R or more has a probability of at most 1/R where
there is nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.normal_equations import inverse_of_lower

SIZES = np.sqrt(10.0 ** np.linspace(0.3, 6.0, 12))  # signal to noise ratios of the best determined direction of an unmodelled effect


def log_bayes_factors(A: np.ndarray, a: np.ndarray, sizes: np.ndarray | None = None, positive: bool = False) -> np.ndarray:
    """(H,) of many blocks A (H, k, k), a (H, k). sizes (S,): of the coefficients; without them, SIZES relative to the best determined
    direction of each. positive: where k is 1, the coefficient cannot be negative.
    """
    value, along = (A[:, 0], a) if a.shape[1] == 1 else eigenvalues(A, a)
    value = np.maximum(value, 0.0)
    square = np.square(sizes)[None] if sizes is not None else np.square(relative_sizes(value.max(axis=1)))
    grown = 1.0 + square * value.T[:, :, None]  # (k, H, S)
    terms = 0.5 * (square * np.sum(along.T[:, :, None] ** 2 / grown, axis=0) - np.sum(np.log(grown), axis=0))
    if positive and a.shape[1] == 1:
        terms = terms + log_twice_normal(np.sqrt(square) * a / np.sqrt(grown[0]))
    return log_mean(terms)


def relative_sizes(largest: np.ndarray) -> np.ndarray:
    """(H, S) sizes of coefficients, the largest eigenvalue of whose normal matrix in typical sizes is given (H,).

    What the projection left less than one over the largest size of, in columns of unit size, has no evidence.
    """
    return SIZES / np.maximum(np.sqrt(np.maximum(largest, 0.0)), 1 / SIZES[-1])[:, None]


def log_mean(logs: np.ndarray) -> np.ndarray:
    """log of the mean of exp(logs) along the last axis."""
    peak = np.max(logs, axis=-1, keepdims=True)
    return peak[..., 0] + np.log(np.mean(np.exp(logs - peak), axis=-1))


def log_twice_normal(x: np.ndarray) -> np.ndarray:
    """Log of twice the standard normal distribution function: what it is worth that a coefficient cannot be negative."""
    return log_ndtr(x) - log_ndtr(0.0)


def log_set_bayes_factor(
    A: np.ndarray, a: np.ndarray, slices: list[slice], sizes: list[np.ndarray], positive: list[bool]
) -> tuple[float, list[float]]:
    """Log Bayes factor of a set of effects together, and the most probable size of each.

    A (k, k), a (k,): of all coefficients in typical sizes; slices: of each effect; sizes: ascending. The average over the sizes of all is
    taken about the most probable ones, one effect at a time.
    """
    chosen = np.array([0.5 * (s[(len(s) - 1) // 2] + s[len(s) // 2]) for s in sizes])
    effects = [_OneEffect(A, a, slices, j, positive) for j in range(len(slices))]
    spread, best = np.zeros(len(slices)), np.full(len(slices), -np.inf)
    asked: list[list[float] | None] = [None] * len(slices)  # sizes of the others with which an effect was evaluated last
    for _ in range(3):
        before = chosen.tolist()
        for j, own in enumerate(sizes):
            others = without(chosen, j, j + 1)
            if others.tolist() == asked[j]:
                continue
            asked[j] = others.tolist()
            values = effects[j].log_factors(others, own)
            chosen[j], best[j] = own[values.argmax()], values.max()
            spread[j] = float(np.logaddexp.reduce(values) - best[j]) - float(np.log(len(own)))
        if chosen.tolist() == before:
            break
    return float(best[-1]) + float(sum(spread)), chosen.tolist()


def over_sizes(
    A: np.ndarray, a: np.ndarray, slices: list[slice], sizes: list[np.ndarray], chosen: list[float], positive: list[bool]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (k,) and covariance (k, k) of the coefficients of a set, averaged over the sizes of each effect by their probability.

    The average is taken about the most probable sizes ``chosen``, one effect at a time, as that of the Bayes factor.
    """
    best = np.array(chosen)
    width = [p.stop - p.start for p in slices]
    mean, covariance = posterior_of(A, a, np.repeat(best, width))
    total, spread = mean.copy(), covariance.copy()
    for j, own in enumerate(sizes):
        logs = _OneEffect(A, a, slices, j, positive).log_factors(without(best, j, j + 1), own)
        share = np.exp(logs - np.logaddexp.reduce(logs))
        each = [posterior_of(A, a, np.repeat(np.where(np.arange(len(best)) == j, size, best), width)) for size in own]
        away = np.array([m - mean for m, _ in each])
        middle = share @ away
        total += middle
        spread += sum(p * (v - covariance + np.outer(d - middle, d - middle)) for p, d, (_, v) in zip(share, away, each, strict=True))
    return total, spread


def posterior_of(A: np.ndarray, a: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (k,) and covariance (k, k) of coefficients of these sizes (k,)."""
    inverse = t[:, None] * np.linalg.inv(t[:, None] * A * t + np.eye(len(t))) * t
    return inverse @ a, inverse


def without(values: np.ndarray, start: int, stop: int) -> np.ndarray:
    """The values but those from start to stop; quicker than ``np.delete``, and called thousands of times."""
    return np.concatenate([values[:start], values[stop:]])


class _OneEffect:
    """An effect j of a set, the others of which are eliminated at given sizes."""

    def __init__(self, A: np.ndarray, a: np.ndarray, slices: list[slice], j: int, positive: list[bool]):
        own, width = slices[j], np.array([p.stop - p.start for p in slices])
        rest = without(np.arange(len(a)), own.start, own.stop)
        self.width = without(width, j, j + 1)
        self.positive = positive[j]
        self.own, self.right = A[own, own], a[own]
        self.across, self.others, self.others_right = A[rest, own], A[rest[:, None], rest], a[rest]
        starts = [p.start for i, p in enumerate(slices) if positive[i] and i != j]
        self.positive_others = np.searchsorted(rest, starts)

    def log_factors(self, sizes: np.ndarray, own: np.ndarray) -> np.ndarray:
        """(S,) log Bayes factor of the set with each of the sizes own (S,) of the effect, the others having these sizes.

        The others are eliminated, and what remains of the effect is taken along its eigenvectors, in which every size is a number.
        """
        t = np.repeat(sizes, self.width)
        normal = t[:, None] * self.others * t
        normal.flat[:: len(t) + 1] += 1.0
        root = np.linalg.cholesky(normal)
        inverse = inverse_of_lower(root) if len(root) else root
        across, beyond = inverse @ (t[:, None] * self.across), inverse @ (t * self.others_right)
        beside = self.own - across.T @ across
        value, vectors = (beside[0], np.ones((1, 1))) if len(beside) == 1 else np.linalg.eigh(beside)
        along, square = vectors.T @ (self.right - across.T @ beyond), own[:, None] ** 2
        grown = 1.0 + square * np.maximum(value, 0.0)
        constant = 0.5 * float(beyond @ beyond) - float(np.log(root.diagonal()).sum())
        logs = constant + 0.5 * np.sum(square * along**2 / grown - np.log(grown), axis=1)
        if self.positive:
            logs = logs + log_twice_normal(own * along[0] / np.sqrt(grown[:, 0]))
        if len(self.positive_others):
            # Mean and variance of the others' coefficients, in their sizes, fall and grow with what the effect takes.
            back = inverse[:, self.positive_others].T
            moved, mean = back @ (across @ vectors), back @ beyond
            share = square / grown
            variance = np.sum(back**2, axis=1) + share @ (moved**2).T
            logs = logs + np.sum(log_twice_normal((mean - (share * along) @ moved.T) / np.sqrt(variance)), axis=1)
        return logs


def prior_sigma(candidate: Candidate) -> np.ndarray:
    """(k,) prior standard deviation of the coefficients: an effect far larger than its typical size is not believed."""
    return OPTIONS.sizes[-1] * candidate.typical


def prior_weight(candidate: Candidate) -> np.ndarray:
    """(k,) prior inverse variance of the coefficients."""
    return 1.0 / prior_sigma(candidate) ** 2


def eigenvalues(S: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (H, k) of symmetric S (H, k, k), and b (H, k) along their directions."""
    if S.shape[1] == 2:  # the usual case, sine and cosine of a harmonic
        return _of_two_by_two(S, b)
    w, V = np.linalg.eigh(S)
    return w, (np.swapaxes(V, 1, 2) @ b[:, :, None])[:, :, 0]


def _of_two_by_two(S: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    middle, half = 0.5 * (S[:, 0, 0] + S[:, 1, 1]), 0.5 * (S[:, 0, 0] - S[:, 1, 1])
    radius, angle = np.hypot(half, S[:, 0, 1]), 0.5 * np.arctan2(S[:, 0, 1], half)
    c, s = np.cos(angle), np.sin(angle)
    along = np.stack([c * b[:, 1] - s * b[:, 0], c * b[:, 0] + s * b[:, 1]], axis=1)
    return np.stack([middle - radius, middle + radius], axis=1), along
