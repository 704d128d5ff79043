"""A recorded channel at shifted times."""

from __future__ import annotations

import numpy as np


def shift_difference(signal: np.ndarray, step_s: float, delay_s: float) -> np.ndarray:
    """Change (T,) of an equidistant signal when it is read ``delay_s`` later: what the correction of a late channel adds to its
    mismatch. Beyond the ends the signal keeps its last value."""
    if delay_s == 0.0:
        return np.zeros(len(signal))
    from scipy.interpolate import CubicSpline  # takes long to import, and a report of poses comes by here

    time = step_s * np.arange(len(signal))
    return CubicSpline(time, signal)(np.clip(time + delay_s, 0.0, time[-1])) - signal
