"""Warm-up over time: an exponential whose time constant is to be found."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import FADING, Hyperparameter

TIME_CONSTANT = "time_constant_s"


def time_constant(context: Context) -> Hyperparameter:
    """Time constants from a few hundredths to twice the duration of the recording."""
    total = float(np.ptp(context.time))
    return Hyperparameter(TIME_CONSTANT, np.geomspace(0.03 * total, 2.0 * total, 16), 2.0, kind=FADING)


def time_constant_std(tau: float, c: np.ndarray, v: np.ndarray) -> float:
    """Rough standard deviation of tau: the fading and its derivative by log tau are about equally large."""
    size = float(np.linalg.norm(c))
    return float(tau * 2.0 * np.sqrt(np.trace(v)) / max(size, 1e-30))
