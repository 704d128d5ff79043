"""Log Bayes factor of a set of effects, averaged over the sizes of the coefficients of each (``nonparametric.bayes_factor``)."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.nonparametric.bayes_factor import log_twice_normal
from mbcacq.estimation.normal_equations import inverse_of_lower


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
    mean, covariance = _posterior(A, a, slices, best)
    total, spread = mean.copy(), covariance.copy()
    for j, own in enumerate(sizes):
        logs = _OneEffect(A, a, slices, j, positive).log_factors(without(best, j, j + 1), own)
        share = np.exp(logs - np.logaddexp.reduce(logs))
        each = [_posterior(A, a, slices, np.where(np.arange(len(best)) == j, size, best)) for size in own]
        away = np.array([m - mean for m, _ in each])
        middle = share @ away
        total += middle
        spread += sum(p * (v - covariance + np.outer(d - middle, d - middle)) for p, d, (_, v) in zip(share, away, each, strict=True))
    return total, spread


def _posterior(A: np.ndarray, a: np.ndarray, slices: list[slice], sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of all coefficients at one size of each effect."""
    t = np.repeat(sizes, [p.stop - p.start for p in slices])
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
