"""Log Bayes factor of a set of effects, averaged over the sizes of the coefficients of each (``nonparametric.bayes_factor``)."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.nonparametric.bayes_factor import log_twice_normal


def log_set_bayes_factor(
    A: np.ndarray, a: np.ndarray, slices: list[slice], sizes: list[np.ndarray], positive: list[bool]
) -> tuple[float, list[float]]:
    """Log Bayes factor of a set of effects together, and the most probable size of each.

    A (k, k), a (k,): of all coefficients in typical sizes; slices: of each effect. The average over the sizes of all is taken about the
    most probable ones, one effect at a time.
    """
    chosen = [float(np.median(s)) for s in sizes]
    spread: list[float] = [0.0] * len(slices)
    best = -np.inf
    for _ in range(3):
        before = list(chosen)
        for j, own in enumerate(sizes):
            values = _log_factors(A, a, slices, chosen, j, own, positive)
            chosen[j], best = float(own[values.argmax()]), float(values.max())
            spread[j] = float(np.logaddexp.reduce(values) - best) - float(np.log(len(own)))
        if chosen == before:
            break
    return best + sum(spread), chosen


def _log_factors(
    A: np.ndarray, a: np.ndarray, slices: list[slice], chosen: list[float], j: int, own: np.ndarray, positive: list[bool]
) -> np.ndarray:
    """(S,) log Bayes factor of the set with each of the sizes own (S,) of the effect j, the others having those that are chosen.

    The others are eliminated, and what remains of the effect is taken along its eigenvectors, in which every size is a number.
    """
    mine = np.arange(slices[j].start, slices[j].stop)
    rest = np.r_[0 : slices[j].start, slices[j].stop : len(a)]
    t = np.concatenate([np.full(p.stop - p.start, s) for p, s in zip(slices, chosen, strict=True)])[rest]
    root = np.linalg.cholesky(np.eye(len(rest)) + t[:, None] * A[rest][:, rest] * t)
    inverse = np.linalg.inv(root)
    across, beyond = inverse @ (t[:, None] * A[rest][:, mine]), inverse @ (t * a[rest])
    value, vectors = np.linalg.eigh(A[mine][:, mine] - across.T @ across)
    along, square = vectors.T @ (a[mine] - across.T @ beyond), own[:, None] ** 2
    grown = 1.0 + square * np.maximum(value, 0.0)
    constant = 0.5 * float(beyond @ beyond) - float(np.log(np.diag(root)).sum())
    logs = constant + 0.5 * np.sum(square * along**2 / grown - np.log(grown), axis=1)
    if positive[j]:
        logs = logs + log_twice_normal(own * along[0] / np.sqrt(grown[:, 0]))
    others = [p.start for i, p in enumerate(slices) if positive[i] and i != j]
    if others:
        # Mean and variance of the others' coefficients, in their sizes, fall and grow with what the effect takes.
        back = inverse[:, np.searchsorted(rest, others)].T
        moved, mean = back @ (across @ vectors), back @ beyond
        share = square / grown
        variance = np.sum(back**2, axis=1) + share @ (moved**2).T
        logs = logs + np.sum(log_twice_normal((mean - (share * along) @ moved.T) / np.sqrt(variance)), axis=1)
    return logs
