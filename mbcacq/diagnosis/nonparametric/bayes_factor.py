"""Bayes factor of a group of coefficients of unknown size: the ratio of marginal likelihoods with the group and without it.

The coefficients are a random effect u ~ N(0, s^2 diag(w^2)); the ratio is averaged over a grid of sizes s. Without an effect its
expectation is one, whatever the group, so averages over groups (with prior shares) may be compared, and an average of R or more has a
probability of at most 1/R where there is nothing.
"""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.search.projected_solve import eigenvalues

SIZES = 10.0 ** np.linspace(0.3, 6.0, 12)  # squares of the signal to noise ratio of a group's best determined direction
MOST_FACTORS = 40  # of a determinant that is one product


def log_bayes_factor(
    S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray, least: float = -np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """S: projected normal matrices (H, k, k); b: right-hand sides (H, k); raw: columns squared before projection (H, k); weight: (H, k).

    Returns the log Bayes factor (H,), the gain in chi2 at the best size (H,) and how many coefficients the data determine there (H,).
    Groups whose log Bayes factor cannot reach ``least`` have -inf, 0 and 0: half of the gain with coefficients of any size bounds it.
    """
    scale = weight / np.sqrt(np.maximum(raw, 1e-300))
    scaled, target = S * (scale[:, :, None] * scale[:, None, :]), b * scale
    if least < 0:  # no gain is
        return _log_bayes_factor(scaled, target)
    k = S.shape[1]
    floor = np.maximum(np.trace(scaled, axis1=1, axis2=2) / k, 1e-6) / SIZES[-1]  # not above one over the largest size
    regular = scaled + floor[:, None, None] * np.eye(k)
    bound = 0.5 * np.sum(target * np.linalg.solve(regular, target[:, :, None])[:, :, 0], axis=1)
    possible = bound > least
    out = np.full(len(S), -np.inf), np.zeros(len(S)), np.zeros(len(S))
    for whole, part in zip(out, _log_bayes_factor(scaled[possible], target[possible]), strict=True):
        whole[possible] = part
    return out


def _log_bayes_factor(scaled: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of scaled groups: S (H, k, k) and b (H, k)."""
    if scaled.shape[1] == 1:
        value, along2 = np.maximum(scaled[:, 0], 0.0), target**2
    else:
        value, along = eigenvalues(scaled, target)
        value, along2 = np.maximum(value, 0.0), along**2
    top = np.maximum(value.max(axis=1), 1e-6)  # what the projection removed has no evidence
    size = SIZES[None] / top[:, None]
    grown = 1.0 + size[:, :, None] * value[:, None, :]
    gain = size * np.sum(along2[:, None, :] / grown, axis=2)
    # One logarithm of a product is cheaper than many; of so many factors, none above 1 + the largest size, it is finite.
    log_det = np.log(np.prod(grown, axis=2)) if value.shape[1] <= MOST_FACTORS else np.log(grown).sum(axis=2)
    log = 0.5 * (gain - log_det)
    rows, best = np.arange(len(log)), log.argmax(axis=1)
    peak = log[rows, best]
    mean = peak + np.log(np.mean(np.exp(log - peak[:, None]), axis=1))
    used = np.sum(1.0 - 1.0 / grown[rows, best], axis=1)
    return mean, gain[rows, best], used


def log_mean(logs: np.ndarray) -> float:
    """log of the mean of exp(logs)."""
    peak = float(np.max(logs))
    if peak == -np.inf:
        return peak
    return peak + float(np.log(np.mean(np.exp(np.asarray(logs) - peak))))
