"""Posterior of the coefficients of everything, given some centres, and the predictive density of other centres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.evidence.options import OPTIONS
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.estimation.whitening import CentreWhitening


@dataclass(frozen=True)
class Posterior:
    """sigma: prior of the coefficients (z,). information (z, z), right (z,): normal equations of the centres, without the prior."""

    sigma: np.ndarray
    information: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, whiten: CentreWhitening, columns: np.ndarray, sigma: np.ndarray, residual: np.ndarray) -> Posterior:
        """columns (M, R, z), residual (M, R); the whitener says which centres."""
        X = whiten(columns)
        return cls(sigma, X.T @ X, X.T @ whiten(residual))

    @cached_property
    def normal(self) -> np.ndarray:
        """(z, z) in units of sigma, prior included."""
        return self.sigma[:, None] * self.information * self.sigma + np.eye(len(self.sigma))

    @cached_property
    def solution(self) -> np.ndarray:
        return self.sigma * np.linalg.solve(self.normal, self.sigma * self.right)

    def with_estimated_prior(self, model: EffectSet, slices: list[slice]) -> Posterior:
        """With the effects' coefficients, at these slices, given the prior size that is most probable by these centres (empirical Bayes):
        what is hardly determined stays near zero.
        """
        if not slices:
            return self
        covariance = self.sigma[:, None] * np.linalg.inv(self.normal) * self.sigma
        sigma = self.sigma.copy()
        for (candidate, _), p in zip(model.effects, slices, strict=True):
            t = candidate.typical
            size = most_probable_size(self.solution[p] / t, covariance[p, p] / np.outer(t, t))
            sigma[p] = np.minimum(sigma[p], size * t)
        return replace(self, sigma=sigma)

    def predicted(self, whiten: CentreWhitening, columns: np.ndarray, residual: np.ndarray) -> tuple[float, float]:
        """chi2 of other centres about their prediction, under the covariance of noise and prediction together, and its log determinant
        relative to that of the noise.
        """
        Z, r = whiten(columns), whiten(residual)
        Z *= self.sigma
        normal, right = self.normal + Z.T @ Z, self.sigma * self.right + Z.T @ r
        chi2 = r @ r - right @ np.linalg.solve(normal, right) + self.right @ self.solution
        return float(chi2), float(np.linalg.slogdet(normal)[1] - np.linalg.slogdet(self.normal)[1])


def most_probable_size(values: np.ndarray, covariance: np.ndarray) -> float:
    """Of the possible sizes of an effect, the one under which its estimated coefficients (k,), in typical sizes, are most probable."""

    def log_density(size: float) -> float:
        spread = covariance + size**2 * np.eye(len(values))
        return -0.5 * float(values @ np.linalg.solve(spread, values) + np.linalg.slogdet(spread)[1])

    return max(OPTIONS.sizes, key=log_density)
