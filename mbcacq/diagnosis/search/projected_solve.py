"""Priors of coefficients, and eigenvalues of many small normal matrices at a time."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect import Candidate


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
