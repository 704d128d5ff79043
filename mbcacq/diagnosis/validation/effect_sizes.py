"""Prior sizes of the effects that a posterior is conditioned on: those that are most probable by the centres that are given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.estimation.posterior import Posterior
from mbcacq.estimation.random_effect_sizes import joined


def with_estimated_prior(posterior: Posterior, typical: Sequence[np.ndarray], slices: Sequence[slice]) -> Posterior:
    """With the effects' coefficients, at these slices and of these typical sizes, given the prior size that is most probable by the
    centres seen (empirical Bayes): what is hardly determined stays near zero.
    """
    if not slices:
        return posterior
    covariance = posterior.covariance_of(joined(slices))
    sigma, start = posterior.sigma.copy(), 0
    for t, p in zip(typical, slices, strict=True):
        own = slice(start, start + len(t))
        size = most_probable_size(posterior.solution[p] / t, covariance[own, own] / np.outer(t, t))
        sigma[p] = np.minimum(sigma[p], size * t)
        start += len(t)
    return replace(posterior, sigma=sigma)


def most_probable_size(values: np.ndarray, covariance: np.ndarray) -> float:
    """The size of an effect, among the possible ones, under which its estimated coefficients (k,), in typical sizes, are most probable."""

    def log_density(size: float) -> float:
        spread = covariance + size**2 * np.eye(len(values))
        return -0.5 * float(values @ np.linalg.solve(spread, values) + np.linalg.slogdet(spread)[1])

    return max(OPTIONS.sizes, key=log_density)
