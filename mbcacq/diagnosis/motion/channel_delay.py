"""A recorded channel at shifted times."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline


def shift_difference(signal: np.ndarray, step_s: float, delay_s: float) -> np.ndarray:
    """Change (T,) of an equidistant signal when it is read ``delay_s`` later: what the correction of a late channel adds to its
    mismatch. Beyond the ends the signal keeps its last value."""
    if delay_s == 0.0:
        return np.zeros(len(signal))
    time = step_s * np.arange(len(signal))
    return CubicSpline(time, signal)(np.clip(time + delay_s, 0.0, time[-1])) - signal
