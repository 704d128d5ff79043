"""Joint model: geometry, parametric effects and random effects as one linear problem."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.variance_components import log_prior, restricted_maximum_likelihood
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.projected_solve import prior_sigma, prior_weight
from mbcacq.estimation.terms import accumulate, term


def columns_of(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Free geometry, parametric effects and random effects together: (M, R, z) and prior sigma (z,)."""
    columns, sigma, _ = linear.nuisance()
    blocks, widths = [columns], [sigma]
    for candidate, hyper in model.effects:
        blocks.append(linear.columns(candidate.build(hyper)))
        widths.append(prior_sigma(candidate))
    if smooth is not None:
        blocks.append(smooth.columns)
        widths.append(smooth.sigma)
    return np.concatenate(blocks, axis=2), np.concatenate(widths)


def noise_with(
    linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel | None, start: NoiseEstimate, prior: NoiseEstimate
) -> NoiseEstimate:
    """Restricted maximum likelihood estimate of the noise with a model in place."""
    return restricted_maximum_likelihood(linear, *columns_of(linear, model, smooth), start, prior)


def conditioned_on_effects(projected: CandidateScoring, model: EffectSet) -> CandidateScoring:
    """The problem with the parametric effects projected out."""
    return projected.conditioned_on([(projected.block(c, h), prior_weight(c)) for c, h in model.effects])


def log_restricted_likelihood(projected: CandidateScoring, conditioned: CandidateScoring, prior_noise: NoiseEstimate) -> float:
    """Twice the log of the restricted likelihood of a noise with its prior, up to a constant.

    conditioned: the problem conditioned on the effects of the model, of whose coefficients no determinant is counted.
    """
    prior = log_prior(projected.noise, prior_noise, projected.linear)
    return -projected.whiten.log_det - projected.log_det - conditioned.chi2 + 2 * prior


def kept_centres(projected: CandidateScoring, model: EffectSet) -> np.ndarray:
    """(M,) bool of the centres that are no outliers with the model in place, by instrument and joint noise."""
    linear = projected.linear
    columns, sigma = columns_of(linear, model, None)
    Z = projected.whiten(columns) * sigma
    normal = Z.T @ Z
    residual = linear.residual - columns @ (sigma * np.linalg.solve(normal + np.eye(len(sigma)), Z.T @ projected.r0))
    J = linear.joint * projected.noise.joint
    S = J @ np.swapaxes(J, 1, 2)
    S[:, np.arange(linear.width), np.arange(linear.width)] += projected.noise.rows(linear.width) ** 2
    square = np.einsum("mr,mr->m", residual, np.linalg.solve(S, residual[:, :, None])[:, :, 0])
    typical = max(float(np.median(square[linear.keep])) / chi2.median(linear.width), 1.0)
    return square < typical * chi2.isf(OPTIONS.outlier_level, linear.width)


def relinearized(linear: LinearProblem, model: EffectSet, noise: NoiseEstimate) -> LinearProblem:
    """Linearised anew with the model in place: a fit without it had distorted the derivatives."""
    if not model.effects:
        return linear
    columns, sigma = columns_of(linear, model, None)
    whiten = linear.whitener(noise)
    scaled = whiten(columns) * sigma
    normal = scaled.T @ scaled
    solution = sigma * np.linalg.solve(normal + np.eye(len(sigma)), scaled.T @ whiten(linear.residual))
    _, _, layout = linear.nuisance()
    terms = [term(c.name, c.build(h)) for c, h in model.effects]
    ends = layout.size + np.cumsum([0] + [c.k for c, _ in model.effects])
    values = [solution[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    state = linear.moved(solution[: layout.size], layout)
    new = LinearProblem.of(linear.obs, state, linear.keep, accumulate(linear.obs, terms, values))
    residual = new.residual
    for one, value in zip(terms, values, strict=True):
        residual = residual + new.columns(list(one.parts)) @ value
    return new.with_residual(residual)
