"""Periodic functions of the place in the field of view: fringes, lens tiles and pixel grids leave errors that no polynomial follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.projected_solve import solve_blocks

SHORTEST = 8.0  # mm
FINENESS = 0.25  # of a period over the whole width, from one trial to the next
MOST_WAVES = 16  # over the width of the field
WAVE = 0.3  # size of a wave beside a polynomial of the same group


@dataclass(frozen=True)
class PeriodicComponent:
    """The best wave over one field axis: gain in chi2, its two coefficients' angular frequency in rad/mm, and how many were tried."""

    gain: float
    frequency: float
    independent: float


def scan(screen: CandidateScoring, values: np.ndarray, chunk: int = 24) -> PeriodicComponent | None:
    """values: (M,) mm along one axis of the field; each of the scanner's three components may ripple. None where the field is narrow."""
    width = float(np.ptp(values))
    if width < 2 * SHORTEST:
        return None
    frequencies = 2 * np.pi * np.arange(1.0, width / SHORTEST, FINENESS) / width
    gains = []
    for component in range(3):
        unit = screen.linear.unit("point", 0, component)
        for start in range(0, len(frequencies), chunk):
            phase = frequencies[start : start + chunk] * values[:, None]
            F = np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(values), -1)
            X = screen.whiten(unit[:, :, None] * F[:, None, :])
            taken = (screen.all_projected.T @ X).reshape(-1, F.shape[1] // 2, 2)
            pairs = X.reshape(len(X), -1, 2)
            S = np.einsum("rhi,rhj->hij", pairs, pairs) - np.einsum("zhi,zhj->hij", taken, taken)
            gains.append(solve_blocks(S, (X.T @ screen.r).reshape(-1, 2), np.sum(pairs**2, axis=0)))
    gains = np.concatenate(gains).reshape(3, -1)
    best = int(np.argmax(gains.max(axis=0)))
    return PeriodicComponent(float(gains.max()), float(frequencies[best]), 3.0 * width / SHORTEST)


def waves(values: np.ndarray) -> np.ndarray:
    """(M, 2 K) sine and cosine in turns, over a field axis, by half turns down to the shortest period."""
    low, high = np.quantile(values, [0.05, 0.95])
    width = float(high - low) / 0.9  # of the field that is used; a few balls far outside do not count
    if width < 2 * SHORTEST:
        return np.zeros((len(values), 0))
    turns = 0.5 * np.arange(2, 2 * min(np.floor(1.15 * width / SHORTEST), MOST_WAVES) + 1)
    phase = 2 * np.pi * (values - low)[:, None] / (1.15 * width) * turns
    return WAVE * np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(values), -1)
