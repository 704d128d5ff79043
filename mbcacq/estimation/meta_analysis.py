"""Values of one quantity from several recordings as a random effect: a common value and a variance between the recordings, by restricted
maximum likelihood (Hardy, Thompson 1996).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

GRID = np.r_[0.0, np.geomspace(1e-2, 1e2, 81)]  # standard deviation between recordings, in the mean standard deviation of one value


@dataclass(frozen=True)
class CommonValue:
    """The random effect behind values of several recordings.

    common, common_std: the common value; between_std: standard deviation between recordings, 0 where the values agree; p_value: of the
    values (R,) under no difference between recordings.
    """

    common: float
    common_std: float
    between_std: float
    p_value: float


def random_effect(values: np.ndarray, std: np.ndarray) -> CommonValue:
    """The random effect behind values (R,) with standard deviations (R,)."""
    between = between_std(values, std)
    common, own = weighted_mean(values, std**2 + between**2)
    fixed, _ = weighted_mean(values, std**2)
    p_value = float(chdtrc(len(values) - 1, np.sum((values - fixed) ** 2 / std**2)))
    return CommonValue(common, own, between, p_value)


def weighted_mean(values: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """The mean of values (R,) by their inverse variance (R,), and its standard deviation."""
    weight = 1.0 / variance
    return float(np.sum(weight * values) / weight.sum()), float(1.0 / np.sqrt(weight.sum()))


def between_std(values: np.ndarray, std: np.ndarray) -> float:
    """Most probable standard deviation between recordings."""
    scale = float(np.sqrt(np.mean(std**2)))
    grid = GRID * max(scale, float(np.std(values)) / 10)
    variance = std**2 + grid[:, None] ** 2
    weight = 1.0 / variance
    total = weight.sum(axis=1)
    mean = np.sum(weight * values, axis=1) / total
    log = -0.5 * (np.log(variance).sum(axis=1) + np.log(total) + np.sum(weight * (values - mean[:, None]) ** 2, axis=1))
    return float(grid[int(np.argmax(log))])
