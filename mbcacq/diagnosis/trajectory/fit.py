"""Least squares for one channel, with correlated noise whitened by an autoregression and priors on the base columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

ORDER = 12  # of the autoregression: 50 ms at 4 ms


@dataclass(frozen=True)
class Fit:
    """coefficients (k,) of the effect columns and their covariance; sse of the whitened data with the base's penalty; dof."""

    coefficients: np.ndarray
    covariance: np.ndarray
    base: np.ndarray
    sse: float
    dof: float


def autoregression(residuals: list[np.ndarray], order: int = ORDER) -> np.ndarray:
    """Whitening filter (order + 1,) of a noise with the residuals' autocorrelation (Yule-Walker), scaled to unit innovations."""
    lags = np.zeros(order + 1)
    for r in residuals:
        r = r - r.mean()
        lags += np.array([r[: len(r) - k] @ r[k:] for k in range(order + 1)])
    lags /= sum(len(r) for r in residuals)
    if lags[0] <= 0:
        return np.concatenate([[1.0], np.zeros(order)])
    lags[0] *= 1.0 + 1e-9
    taps = solve_toeplitz(lags[:-1], lags[1:])
    innovation = max(lags[0] - taps @ lags[1:], 1e-12 * lags[0])
    return np.concatenate([[1.0], -taps]) / np.sqrt(innovation)


def whiten(taps: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Filter (T,) or (T, k) along time; the samples that lack a past are left out."""
    if signal.size == 0:
        return signal[len(taps) - 1:]
    return lfilter(taps, [1.0], signal, axis=0)[len(taps) - 1:]


def solve(mismatch: np.ndarray, base: np.ndarray, columns: np.ndarray, prior: np.ndarray) -> Fit:
    """Whitened mismatch (T,), base (T, b) with prior sigmas (b,), effect columns (T, k) -> Fit."""
    A = np.concatenate([columns, base], axis=1)
    k = columns.shape[1]
    pull = np.concatenate([np.zeros(k), np.where(np.isfinite(prior), 1.0 / prior, 0.0)])
    scale = np.maximum(np.sqrt((A**2).sum(axis=0) + pull**2), 1e-300)
    weight = pull / scale
    B = A / scale
    normal = B.T @ B + np.diag(weight**2)
    values, vectors = np.linalg.eigh(normal)
    keep = values > 1e-11 * values[-1]
    inverse = (vectors[:, keep] / values[keep]) @ vectors[:, keep].T
    x = inverse @ (B.T @ mismatch)
    left = mismatch - B @ x
    sse = float(left @ left + (weight * x) @ (weight * x))
    dof = max(len(mismatch) - float(np.trace(inverse @ (B.T @ B))), 1.0)
    # Innovations have unit variance by construction of the filter only if the model is complete: scale by what is left.
    inverse = inverse * max(float(left @ left) / dof, 1.0)
    return Fit((x / scale)[:k], inverse[:k, :k] / np.outer(scale[:k], scale[:k]), (x / scale)[k:], sse, dof)
