"""Bayes factor of coefficients of unknown size: the ratio of marginal likelihoods with them and without.

Coefficients are normal with standard deviations s times typical; each size s of a few is equally probable beforehand. With A = D X'PX D and
a = D X'Pr (D: typical sizes), log BF(s) = 1/2 (s^2 a'(I + s^2 A)^-1 a - ln|I + s^2 A|). Without an effect its expectation is one, whatever
the columns, so averages over blocks (with prior shares) may be compared. An average of R or more has a probability of at most 1/R where
there is nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from mbcacq.diagnosis.search.projected_solve import eigenvalues

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
