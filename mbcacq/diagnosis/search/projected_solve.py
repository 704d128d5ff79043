"""Gains and coefficients of blocks of a projected normal matrix, one or many at a time."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect import Candidate


def prior_sigma(candidate: Candidate) -> np.ndarray:
    """(k,) prior standard deviation of the coefficients: an effect far larger than its typical size is not believed."""
    return OPTIONS.typical_multiple * candidate.typical


def prior_weight(candidate: Candidate) -> np.ndarray:
    """(k,) prior inverse variance of the coefficients."""
    return 1.0 / prior_sigma(candidate) ** 2


def solve_block(S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray | float = 0.0) -> tuple[float, np.ndarray, np.ndarray]:
    """Gain, coefficients, covariance of a projected normal matrix; directions that the projection destroyed are held at zero."""
    S = S + np.diag(np.broadcast_to(weight, len(b)))
    size = np.sqrt(np.maximum(raw, 1e-300))
    w, V = np.linalg.eigh(S / np.outer(size, size))
    inverse = np.where(w > OPTIONS.smallest_share, 1.0 / np.maximum(w, OPTIONS.smallest_share), 0.0)
    pseudo = (V * inverse) @ V.T / np.outer(size, size)
    coefficients = pseudo @ b
    return float(b @ coefficients), coefficients, pseudo


def solve_blocks(S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray | float = 0.0) -> np.ndarray:
    """Gains (H,) of many blocks (H, k, k), (H, k); weight: (k,) or (H, k)."""
    k = b.shape[1]
    S = S + np.broadcast_to(weight, b.shape)[:, :, None] * np.eye(k)
    size = np.sqrt(np.maximum(raw, 1e-300))
    scaled, target = S / (size[:, :, None] * size[:, None, :]), b / size
    if S.shape[1] == 1:
        good = scaled[:, 0, 0] > OPTIONS.smallest_share
        return np.where(good, target[:, 0] ** 2 / np.maximum(scaled[:, 0, 0], OPTIONS.smallest_share), 0.0)
    w, along = eigenvalues(scaled, target)
    return np.sum(np.where(w > OPTIONS.smallest_share, along**2 / np.maximum(w, OPTIONS.smallest_share), 0.0), axis=1)


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
