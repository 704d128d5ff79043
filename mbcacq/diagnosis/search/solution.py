"""A set of effects solved together with the geometry."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet, SelectedEffects
from mbcacq.diagnosis.search.projected_solve import prior_weight


def solved(projected: CandidateScoring, effects: SelectedEffects) -> EffectSet:
    """The set with its coefficients, their covariance and the gain, beyond geometry and what the problem is conditioned on."""
    X = np.concatenate([np.zeros((len(projected.r0), 0)), *(projected.block(c, h) for c, h in effects)], axis=1)
    absorbed = projected.all_projected.T @ X
    S = X.T @ X - absorbed.T @ absorbed + np.diag(np.concatenate([np.zeros(0), *(prior_weight(c) for c, _ in effects)]))
    size = np.sqrt(np.diag(S))
    covariance = np.linalg.inv(S / np.outer(size, size) + 1e-12 * np.eye(len(S))) / np.outer(size, size)
    values = covariance @ (X.T @ projected.r)
    return EffectSet(effects, float(values @ (X.T @ projected.r)), values, covariance)
