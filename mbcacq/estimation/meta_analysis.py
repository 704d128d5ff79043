"""Values of one quantity from several recordings as a random effect: a common value and a variance between the recordings, by restricted
maximum likelihood (Hardy, Thompson 1996).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy.special import chdtrc

from mbcacq.model.json_text import Number

DIFFERENT = 0.01  # p-value below which recordings are said to differ
GRID = np.r_[0.0, np.geomspace(1e-2, 1e2, 81)]  # standard deviation between recordings, in the mean standard deviation of one value


@dataclass(frozen=True, kw_only=True)
class BetweenRecordings:
    """One parameter, or coefficient, of an effect over several recordings of one arm.

    name, where: of the effect. values, stds: of each recording by itself, with the geometry of all. common +- common_std: what they share,
    its uncertainty with the variance between recordings; between_std: standard deviation from day to day beyond each value's own, 0 where
    the values agree; p_value: of values that differ as much although nothing changed.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    values: tuple[Number, ...]
    stds: tuple[Number, ...]
    common: Number
    common_std: Number
    between_std: Number
    p_value: Number

    @classmethod
    def of(cls, name: str, where: tuple[str, ...], parameter: str, values: np.ndarray, std: np.ndarray, **further: Any) -> Self:
        """The random effect behind values (R,) with standard deviations (R,). further: fields that a subclass adds."""
        between = between_std(values, std)
        common, own = weighted_mean(values, std**2 + between**2)
        fixed, _ = weighted_mean(values, std**2)
        return cls(
            name=name,
            where=where,
            parameter=parameter,
            values=tuple(values.tolist()),
            stds=tuple(std.tolist()),
            common=common,
            common_std=own,
            between_std=between,
            p_value=float(chdtrc(len(values) - 1, np.sum((values - fixed) ** 2 / std**2))),
            **further,
        )

    @property
    def differs(self) -> bool:
        """Whether the values are more unlike than their standard deviations allow."""
        return self.p_value <= DIFFERENT


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
