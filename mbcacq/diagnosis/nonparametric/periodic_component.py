"""Periodic component of an error over the field of view: fringes, lens tiles and pixel grids leave what no polynomial follows."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS


def harmonics(values: np.ndarray) -> np.ndarray:
    """(M, 2 K) sine and cosine of the position ``values`` (M,) mm along a field axis, by half periods down to the shortest one."""
    shortest = OPTIONS.shortest_period_mm
    low, high = np.quantile(values, [0.05, 0.95])
    width = float(high - low) / 0.9  # of the field that is used; a few balls far outside do not count
    if width < 2 * shortest:
        return np.zeros((len(values), 0))
    periods = 0.5 * np.arange(2, 2 * min(np.floor(1.15 * width / shortest), OPTIONS.most_harmonics) + 1)
    phase = 2 * np.pi * (values - low)[:, None] / (1.15 * width) * periods
    return OPTIONS.harmonic_weight * np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(values), -1)
