"""Joint model: geometry, parametric effects and random effects as one linear problem."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.projected_solve import prior_sigma, prior_weight
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.outliers import outlier_distances, reject_outliers
from mbcacq.estimation.own_columns import OwnColumns
from mbcacq.estimation.pose_columns import PoseColumns
from mbcacq.estimation.pose_information import PoseInformation
from mbcacq.estimation.solver import Weights
from mbcacq.estimation.terms import term
from mbcacq.estimation.variance_components import NoisePrior, restricted_maximum_likelihood


def effect_columns(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Parametric effects and random effects: columns (M, R, k) and prior sigma (k,)."""
    blocks = [linear.columns(candidate.build(hyper)) for candidate, hyper in model.effects]
    widths = [prior_sigma(candidate) for candidate, _ in model.effects]
    if smooth is not None:
        blocks.append(smooth.columns)
        widths.append(smooth.sigma)
    nothing = np.zeros((*linear.residual.shape, 0))
    return np.concatenate([nothing, *blocks], axis=2), np.concatenate([np.zeros(0), *widths])


def columns_of(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Free geometry, parametric effects and random effects together: (M, R, z) and prior sigma (z,)."""
    parts = linear.nuisance(), effect_columns(linear, model, smooth)
    return np.concatenate([columns for columns, _ in parts], axis=2), np.concatenate([sigma for _, sigma in parts])


def noise_with(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel | None, start: Noise, prior: NoisePrior) -> Noise:
    """Restricted maximum likelihood estimate of the noise with a model in place."""
    extended = linear.extended(*effect_columns(linear, model, smooth))
    return restricted_maximum_likelihood(lambda noise: extended.at(noise).after_fit(), start, prior)


def conditioned_on_effects(projected: CandidateScoring, model: EffectSet) -> CandidateScoring:
    """The problem with the parametric effects projected out."""
    return projected.conditioned_on([(projected.block(c, h), prior_weight(c)) for c, h in model.effects])


def kept_centres(projected: CandidateScoring, model: EffectSet) -> np.ndarray:
    """(M,) bool of the centres that are no outliers with the model in place, by the rule of the adjustment."""
    linear = projected.linear
    columns, sigma = columns_of(linear, model, None)
    Z = projected.whiten(columns) * sigma
    normal = Z.T @ Z
    residual = linear.residual - columns @ (sigma * np.linalg.solve(normal + np.eye(len(sigma)), Z.T @ projected.r0))
    pose = linear.obs.pose
    whole = np.bincount(pose, linear.keep, linear.obs.n_poses) > 0  # of the others the pose was rejected, not its centres
    weights = Weights((linear.keep | ~whole[pose]).astype(float), whole.astype(float))
    judged = outlier_distances(poses_by_joints(linear, residual, projected.noise, weights), residual, projected.noise, weights)
    found = reject_outliers(judged, weights, pose)
    return (found.centre > 0) & (found.pose[pose] > 0)


def poses_by_joints(linear: LinearProblem, residual: np.ndarray, noise: Noise, weights: Weights) -> PoseInformation:
    """The poses of a linear problem with no columns but those of the joints; residual: (M, R)."""
    rows, J = linear.rows, linear.joint
    n, none = J.shape[2], OwnColumns(np.zeros((len(J), rows.width, 3)), np.zeros((len(J), rows.depth), int), 0, np.zeros((*J.shape[:2], 0)))
    columns = PoseColumns(
        J, np.zeros((len(J), n, 0)), np.zeros((len(J), n, 6)), np.broadcast_to(np.eye(n), (len(J), n, n)), none, rows.pad(residual)
    )
    return PoseInformation.of(rows, columns, noise, weights.centre, weights.pose)


def relinearized(linear: LinearProblem, model: EffectSet, noise: Noise) -> LinearProblem:
    """Adjusted and linearised anew with the model in place: a fit without it had distorted the derivatives."""
    if not model.effects:
        return linear
    sigmas = ((c.name, c.build(h), prior_sigma(c)) for c, h in model.effects)
    return linear.adjusted([term(name, parts, sigma=sigma) for name, parts, sigma in sigmas], noise)
