"""Coefficients of a hypothesis of poses together with the geometry, and what they displace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.search.effect_columns import candidate_columns, candidate_parts
from mbcacq.diagnosis.search.effect_set import prior_sigma
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import term


def solution(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Nuisance parameters and coefficients together (z + k,), and the residual (M, R) that they leave."""
    columns, sigma, Z = _with_geometry(hypothesis)
    values = sigma * np.linalg.solve(Z.T @ Z + np.eye(len(sigma)), Z.T @ hypothesis.point.projected.r0)
    return values, hypothesis.point.linear.residual - columns @ values


def geometry_of(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean (z,) and covariance (z, z) of stations and free geometry, effects integrated out; the last are given effects."""
    _, sigma, Z = _with_geometry(hypothesis)
    z = len(sigma) - len(prior_sigma(hypothesis.members))
    inverse = np.linalg.inv(Z.T @ Z + np.eye(len(sigma)))
    values = sigma * (inverse @ (Z.T @ hypothesis.point.projected.r0))
    return values[:z], (sigma[:, None] * inverse * sigma)[:z, :z]


def _with_geometry(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (M, R, z + k) of stations, free geometry and effects, their prior sigma, and the same whitened, in units of sigma."""
    linear, members = hypothesis.point.linear, hypothesis.members
    columns, sigma = linear.nuisance()
    columns = np.concatenate([columns, *(candidate_columns(linear, m.candidate, m.hyper) for m in members)], axis=2)
    sigma = np.r_[sigma, prior_sigma(members)]
    return columns, sigma, hypothesis.point.projected.whiten(columns) * sigma


def relinearized(linear: LinearProblem, hypothesis: Hypothesis) -> LinearProblem:
    """Linearised anew with the effects in place: a fit without them had distorted the derivatives.

    linear: the problem of the hypothesis without the columns of its discrepancy.
    """
    members = hypothesis.members
    if not members:
        return linear
    effects = [term(m.candidate.name, candidate_parts(linear, m.candidate, m.hyper), sigma=m.size * m.candidate.typical) for m in members]
    return linear.adjusted(effects, hypothesis.point.noise)


def displacements(hypothesis: Hypothesis) -> list[np.ndarray]:
    """(M, R) of each effect, by the mean of its coefficients."""
    linear, found = hypothesis.point.linear, hypothesis.solved
    return [
        candidate_columns(linear, m.candidate, m.hyper) @ found.coefficients[p] for m, p in zip(found.members, found.slices(), strict=True)
    ]


def with_discrepancy(linear: LinearProblem, displaced: list[np.ndarray], share: float) -> LinearProblem:
    """Each effect is wrong, at each pose, by a share of what it displaces there: columns (M, R) as those of a joint's repeatability."""
    if not displaced:
        return linear
    extra = linear.rows.pad(share * np.stack(displaced, axis=2))
    return replace(linear, columns_by_pose=linear.columns_by_pose.with_noise(extra))
