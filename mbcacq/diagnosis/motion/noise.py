"""Noise of a channel, and the uncertainty of coefficients that are fitted in coloured noise.

Three estimates of what the noise does to the normal equations. White: from the size of the residual alone. Spectral: from the residual's
autocovariance within a second, which few data determine poorly. Segments (sandwich): however residuals are correlated within half a second,
and with a variance that changes along the recording; with few segments to a coefficient it comes out too small. The largest of the three is
taken. Prior knowledge of a coefficient has a standard deviation of its own: the prior's spread is part of all three.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve

from mbcacq.diagnosis.motion.normal_store import MISMATCH, NormalStore


def third_difference_noise(signals: tuple[np.ndarray, ...]) -> float:
    """Standard deviation of white noise on smooth signals (T,), from the median of their third differences."""
    third = np.concatenate([np.diff(m, 3) for m in signals])
    return max(float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)), 1e-12)


def covariance(store: NormalStore, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray, correlation_s: float) -> np.ndarray:
    """(c, c) of the coefficients x of the columns ``chosen``; weights: (J,) one over the mean square of the residual.

    correlation_s: residuals further apart than that count as independent.
    """
    inverse = _inverse(store, weights, chosen)
    known = np.diag(1.0 / np.array(store.prior)[chosen] ** 2)
    chi2_dof = float(store.errors(chosen, x) @ weights) / max(store.count.sum() - len(chosen), 1.0)
    white = inverse * max(chi2_dof, 1.0)
    by_segment = _propagated(inverse, _spread_of_scores(store, weights, chosen, x) + known)
    coloured = _propagated(inverse, _spectral(store, weights, chosen, x, correlation_s) + known)
    least = np.maximum(np.maximum(np.diag(white), np.diag(by_segment)), np.diag(coloured))
    # A residual that is zero to rounding has no spectrum: its correlations are those of white noise.
    coloured += 1e-9 * _with_variances(white, least)
    return _with_variances(coloured, least)


def _propagated(inverse: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(c, c) inverse times spread times inverse, as squares of a root of the spread: rounding makes no variance negative."""
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    size, direction = np.linalg.eigh(spread / np.outer(scale, scale))
    root = inverse @ (scale[:, None] * direction * np.sqrt(np.maximum(size, 0.0)))
    return root @ root.T


def _with_variances(matrix: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """A covariance (c, c) with its correlations and these variances (c,)."""
    grow = np.sqrt(variances / np.diag(matrix))
    return matrix * np.outer(grow, grow)


def _inverse(store: NormalStore, weights: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    factor, scale = store.factor(store.normal(weights), chosen)
    return cho_solve(factor, np.eye(len(chosen)), check_finite=False) * np.outer(scale, scale)


def _spread_of_scores(store: NormalStore, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(c, c) from the scores of segments: weighted residual times each column, summed over each segment."""
    scores = np.zeros((len(store.segments), len(chosen)))
    position = store.positions(chosen)
    for j, numbers in enumerate(store.numbers):
        own = np.flatnonzero((numbers >= 0) & (position[numbers] >= 0))
        full = np.zeros(len(numbers))
        full[own], full[numbers == MISMATCH] = -x[position[numbers[own]]], 1.0
        scores[:, position[numbers[own]]] += weights[j] * (store.products[j] @ full)[:, own]
    n = len(scores)
    return scores.T @ scores * n / max(n - 1, 1)


def _spectral(store: NormalStore, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray, correlation_s: float) -> np.ndarray:
    """(c, c) spread of the scores, from the autocovariance of each joint's residual (Bartlett's window)."""
    out = np.zeros((len(chosen), len(chosen)))
    longest = max(int(correlation_s / store.steps[0]), 1)
    length = 2 ** int(np.ceil(np.log2(max(*store.lengths, 0) + longest + 1)))
    for j in range(len(store.matrix)):
        columns, at = store.training_columns(j, chosen)
        residual = store.residual(j, chosen, x) * store.training
        root = np.sqrt(_density(store, residual, store.present(j), longest, length) * weights[j] ** 2 / length)[:, None]
        for run in range(len(store.lengths)):
            spectrum = np.fft.rfft(columns[store.slices(run)], length, axis=0)
            both = np.concatenate([spectrum.real * root, spectrum.imag * root])
            out[np.ix_(at, at)] += both.T @ both
    return out


def _density(store: NormalStore, residual: np.ndarray, present: np.ndarray, longest: int, length: int) -> np.ndarray:
    """(length // 2 + 1,) power spectral density of a residual (Ttot,) with gaps, both halves of the frequencies together."""
    power, pairs = np.zeros(length // 2 + 1), np.zeros(length // 2 + 1)
    for run in range(len(store.lengths)):
        here = store.slices(run)
        power += np.abs(np.fft.rfft(residual[here], length)) ** 2
        pairs += np.abs(np.fft.rfft(present[here], length)) ** 2
    autocovariance = np.fft.irfft(power, length)[: longest + 1] / np.maximum(np.fft.irfft(pairs, length)[: longest + 1], 1.0)
    lags = np.zeros(length)
    lags[: longest + 1] = (1.0 - np.arange(longest + 1) / (longest + 1)) * autocovariance
    lags[length - longest :] = lags[longest:0:-1]
    density = np.maximum(np.fft.rfft(lags).real, 0.0)
    density[1:-1] *= 2.0
    return density
