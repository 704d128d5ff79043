"""Posterior of the coefficients of everything, given some centres, and how well other centres agree with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, cholesky

from mbcacq.estimation.normal_equations import inverse_of_lower
from mbcacq.estimation.whitened_columns import ColumnProducts


@dataclass(frozen=True)
class Posterior:
    """sigma: prior of the coefficients (z,). seen: products of the centres that are given, without the prior."""

    sigma: np.ndarray
    seen: ColumnProducts

    @cached_property
    def root(self) -> np.ndarray:
        """(z, z) lower root of the normal matrix in units of sigma, prior included."""
        return root_of(self.sigma, self.seen.information)

    @cached_property
    def solution(self) -> np.ndarray:
        return self.sigma * self.solved(self.sigma * self.seen.right)

    def solved(self, right: np.ndarray) -> np.ndarray:
        """The inverse of the normal matrix times right (z,) or (z, k), in units of sigma."""
        return cho_solve((self.root, True), right, check_finite=False)

    def covariance_of(self, index: np.ndarray) -> np.ndarray:
        """(k, k) of the coefficients at index (k,)."""
        unit = np.zeros((len(self.sigma), len(index)))
        unit[index, np.arange(len(index))] = self.sigma[index]
        return self.sigma[index, None] * self.solved(unit)[index]

    @property
    def determined(self) -> float:
        """Number of coefficients that the centres determine: what is not known of the others is their prior."""
        half = inverse_of_lower(self.root)
        return float(len(self.sigma) - np.sum(half * half))

    def predicted(self, other: ColumnProducts) -> float:
        """chi2 of other centres about their prediction, under the covariance of noise and prediction together."""
        both = root_of(self.sigma, self.seen.information + other.information)
        right = self.sigma * (self.seen.right + other.right)
        return float(other.square - right @ cho_solve((both, True), right, check_finite=False) + self.seen.right @ self.solution)


def root_of(sigma: np.ndarray, information: np.ndarray) -> np.ndarray:
    """(z, z) lower root of a normal matrix with a prior, in units of its sigma (z,)."""
    normal = sigma[:, None] * information * sigma
    normal[np.diag_indices_from(normal)] += 1.0
    return cholesky(normal, lower=True, overwrite_a=True, check_finite=False)
