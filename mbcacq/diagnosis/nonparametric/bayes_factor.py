"""Bayes factor of a group of coefficients of unknown size: the ratio of marginal likelihoods with the group and without it.

The coefficients are a random effect u ~ N(0, s^2 diag(w^2)); the ratio is averaged over a grid of sizes s. Without an effect its
expectation is one, whatever the group, so averages over groups (with prior shares) may be compared, and an average of R or more is seen
with a probability of at most 1/R where there is nothing.
"""

from __future__ import annotations

import numpy as np

SIZES = 10.0 ** np.linspace(0.3, 6.0, 12)  # squares of the signal to noise ratio of a group's best determined direction


def log_bayes_factor(S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """S: projected normal matrices (H, k, k); b: right-hand sides (H, k); raw: columns squared before projection (H, k); weight: (H, k).

    Returns the log Bayes factor (H,), the gain in chi2 at the best size (H,) and how many coefficients the data determine there (H,).
    """
    scale = weight / np.sqrt(np.maximum(raw, 1e-300))
    scaled, target = S * (scale[:, :, None] * scale[:, None, :]), b * scale
    if S.shape[1] == 1:
        value, along2 = np.maximum(scaled[:, 0], 0.0), target**2
    else:
        value, V = np.linalg.eigh(scaled)
        value, along2 = np.maximum(value, 0.0), np.einsum("hij,hi->hj", V, target) ** 2
    top = np.maximum(value.max(axis=1), 1e-6)  # what the projection removed has no evidence
    size = SIZES[None] / top[:, None]
    grown = size[:, :, None] * value[:, None, :]
    gain = (along2[:, None, :] * size[:, :, None] / (1 + grown)).sum(axis=2)
    log = 0.5 * (gain - np.log1p(grown).sum(axis=2))
    best = log.argmax(axis=1)
    peak = log[np.arange(len(log)), best]
    mean = peak + np.log(np.mean(np.exp(log - peak[:, None]), axis=1))
    rows = np.arange(len(log))
    used = (grown / (1 + grown)).sum(axis=2)
    return mean, gain[rows, best], used[rows, best]


def log_mean(logs: np.ndarray) -> float:
    """log of the mean of exp(logs)."""
    peak = float(np.max(logs))
    return peak + float(np.log(np.mean(np.exp(np.asarray(logs) - peak))))
