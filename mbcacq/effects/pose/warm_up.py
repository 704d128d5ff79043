"""Warm-up with time: an exponential whose time constant is to be found."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Hyperparameter


def time_constant(s: Context) -> Hyperparameter:
    total = float(np.ptp(s.time))
    return Hyperparameter("time_constant_s", np.geomspace(0.03 * total, 2.0 * total, 16), 2.0)


def fading(s: Context):
    """exp(-t / tau): (H,) s -> (H, P, 1)."""
    time = s.time
    return lambda values: np.exp(-time[None] / np.asarray(values)[:, None])[..., None]


def time_constant_std(tau: float, c: np.ndarray, v: np.ndarray) -> float:
    """Rough standard deviation of tau: the fading and its derivative by log tau are about equally large."""
    size = float(np.linalg.norm(c))
    return float(tau * 2.0 * np.sqrt(np.trace(v)) / max(size, 1e-30))
