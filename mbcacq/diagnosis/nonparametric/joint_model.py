"""Geometry, named effects and groups without a name as one linear problem."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.projected_solve import LARGEST, prior_weight
from mbcacq.estimation.terms import accumulate, term


def columns_of(linear: LinearProblem, model: EffectSet, rest: RandomEffectsModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Free geometry, named effects and groups together: (M, R, z) and prior sigma (z,)."""
    columns, sigma, _ = linear.nuisance()
    blocks, widths = [columns], [sigma]
    for candidate, hyper in model.members:
        blocks.append(linear.columns(candidate.build(hyper)))
        widths.append(LARGEST * candidate.typical)
    if rest is not None:
        blocks.append(rest.columns)
        widths.append(rest.sigma)
    return np.concatenate(blocks, axis=2), np.concatenate(widths)


def with_members(screen: CandidateScoring, model: EffectSet) -> CandidateScoring:
    return screen.adopted([(screen.block(c, h), prior_weight(c)) for c, h in model.members])


def adopted(named: CandidateScoring, rest: RandomEffectsModel | None) -> CandidateScoring:
    """The screen with groups projected out, as far as their sizes allow."""
    return named if rest is None else named.adopted([(named.whiten(rest.columns), rest.sigma**-2)])


def outliers(screen: CandidateScoring, members: EffectSet) -> np.ndarray:
    """(M,) bool of the centres worth keeping, judged with the model in place: within seven sigma of instrument and joint noise."""
    linear = screen.linear
    columns, sigma = columns_of(linear, members, None)
    Z = screen.whiten(columns) * sigma
    normal = Z.T @ Z
    left = linear.residual - columns @ (sigma * np.linalg.solve(normal + np.eye(len(sigma)), Z.T @ screen.r0))
    J = linear.joint * screen.noise.joint
    S = J @ np.swapaxes(J, 1, 2)
    S[:, np.arange(linear.width), np.arange(linear.width)] += screen.noise.rows(linear.width) ** 2
    square = np.einsum("mr,mr->m", left, np.linalg.solve(S, left[:, :, None])[:, :, 0])
    typical = max(float(np.median(square[linear.keep])) / chi2.median(linear.width), 1.0)
    return square < typical * chi2.isf(1e-7, linear.width)


def settle(linear: LinearProblem, model: EffectSet, sigma: NoiseEstimate) -> LinearProblem:
    """Linearised anew with the model in place: what a fit without it bent out of shape no longer bends its derivatives."""
    if not model.members:
        return linear
    columns, width = columns_of(linear, model, None)
    Z = linear.whitener(sigma)
    scaled = Z(columns) * width
    normal = scaled.T @ scaled
    solution = width * np.linalg.solve(normal + np.eye(len(width)), scaled.T @ Z(linear.residual))
    _, _, layout = linear.nuisance()
    terms = [term(c.name, c.build(h)) for c, h in model.members]
    ends = layout.size + np.cumsum([0] + [c.k for c, _ in model.members])
    values = [solution[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    new = LinearProblem(linear.obs, linear.moved(solution[: layout.size], layout), linear.keep, accumulate(linear.obs, terms, values))
    for one, value in zip(terms, values, strict=True):
        new.residual = new.residual + new.columns(list(one.parts)) @ value
    return new
