"""Log Bayes factor of one effect, or of a set, averaged over the sizes of its coefficients.

Coefficients are normal with standard deviations s times typical; each size s of a few is equally probable beforehand. With
A = D X'PX D and a = D X'Pr (D: typical sizes), log BF(s) = 1/2 (s^2 a'(I + s^2 A)^-1 a - ln|I + s^2 A|).
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from mbcacq.diagnosis.search.projected_solve import eigenvalues

LN2 = float(np.log(2.0))


def log_bayes_factors(A: np.ndarray, a: np.ndarray, sizes: np.ndarray, positive: bool = False) -> np.ndarray:
    """(H,) of many blocks A (H, k, k), a (H, k). positive: where k is 1, the coefficient cannot be negative."""
    if a.shape[1] == 1:
        value, along = np.maximum(A[:, 0], 0.0), a
    else:
        value, along = eigenvalues(A, a)
        value = np.maximum(value, 0.0)
    square = np.asarray(sizes) ** 2
    grown = 1.0 + square[:, None] * value[:, None, :]
    terms = 0.5 * (square * np.sum(along[:, None, :] ** 2 / grown, axis=2) - np.sum(np.log(grown), axis=2))
    if positive and a.shape[1] == 1:
        terms = terms + LN2 + log_ndtr(np.sqrt(square) * a / np.sqrt(grown[:, :, 0]))
    return np.logaddexp.reduce(terms, axis=1) - np.log(len(square))


def log_set_bayes_factor(
    A: np.ndarray, a: np.ndarray, slices: list[slice], sizes: list[np.ndarray], positive: list[bool]
) -> tuple[float, list[float]]:
    """Of a set of effects together, and the most probable size of each.

    A (k, k), a (k,): of all coefficients in typical sizes; slices: of each effect. The average over the sizes of all is taken about the
    most probable ones, one effect at a time.
    """

    def log_factors(chosen: list[float], j: int) -> np.ndarray:
        """With each of the sizes of the effect j."""
        t = np.concatenate([np.full(p.stop - p.start, s) for p, s in zip(slices, chosen, strict=True)])
        t = np.repeat(t[None], len(sizes[j]), axis=0)
        t[:, slices[j]] = sizes[j][:, None]
        normal = identity + t[:, :, None] * A * t[:, None, :]
        inverse, scaled = np.linalg.inv(normal), t * a
        mean = (inverse @ scaled[:, :, None])[:, :, 0]
        value = 0.5 * (np.sum(scaled * mean, axis=1) - np.linalg.slogdet(normal)[1])
        for p, bounded in zip(slices, positive, strict=True):
            if bounded:
                value = value + LN2 + log_ndtr(mean[:, p.start] / np.sqrt(inverse[:, p.start, p.start]))
        return value

    identity = np.eye(len(a))
    chosen = [float(np.median(s)) for s in sizes]
    spread: list[float] = [0.0] * len(slices)
    best = -np.inf
    for _ in range(3):
        before = list(chosen)
        for j, own in enumerate(sizes):
            values = log_factors(chosen, j)
            chosen[j], best = float(own[values.argmax()]), float(values.max())
            spread[j] = float(np.logaddexp.reduce(values) - best) - float(np.log(len(own)))
        if chosen == before:
            break
    return best + sum(spread), chosen
