"""Joint model: geometry, parametric effects and random effects as one linear problem.

Every group of functions at a location is a random effect u ~ N(0, sigma^2) whose common size maximises the marginal likelihood. Groups
that the data do not ask for vanish, and ranges without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from mbcacq.diagnosis.search.bayes_factor import prior_sigma, prior_weight
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.random_effect_sizes import consecutive, joined, sizes_by_marginal_likelihood
from mbcacq.estimation.terms import Part, at_poses
from mbcacq.estimation.variance_components import NoisePrior, restricted_maximum_likelihood
from mbcacq.estimation.whitened_columns import ColumnProducts, Posterior, WhitenedColumns, root_of
from mbcacq.estimation.whitening import CentreWhitening


@dataclass(frozen=True)
class RandomEffect:
    """location, depends_on: for the report. parts: what k coefficients move, at the poses of a recording. sigma: (k,) their prior."""

    location: str
    depends_on: str
    parts: tuple[Part, ...]
    sigma: np.ndarray

    @classmethod
    def of(cls, here: Covariates, group: EffectTerm) -> RandomEffect:
        """A group of ``mbcacq.effects.unmodelled`` at all poses of a recording, its size not known."""
        return cls(group.where[0], group.depends_on, tuple(evaluated(here, group.parts)), group.sigma)

    def of_poses(self, poses: np.ndarray, pose: np.ndarray) -> RandomEffect:
        """At some poses (P,) bool of the recording; pose: (M,) of its centres."""
        return replace(self, parts=at_poses(self.parts, poses, pose))

    def of_unit_size(self, linear: LinearProblem) -> RandomEffect:
        """With the sigma by which it moves the centres by about a millimetre, or turns the target by a mrad, so that sizes compare."""
        moved = (linear.columns(self.parts) * self.sigma)[linear.keep]
        size = np.sqrt(np.mean(moved[:, :3] ** 2) * moved.shape[2])
        if size == 0 and moved.shape[1] > 3:  # only the orientation is turned
            size = 1e3 * np.sqrt(np.mean(moved[:, 3:] ** 2) * moved.shape[2])
        return replace(self, sigma=self.sigma / max(float(size), 1e-12))


def coefficients_of(groups: Sequence[RandomEffect]) -> list[slice]:
    """Which coefficients belong to which group."""
    return list(consecutive(len(g.sigma) for g in groups))


class JointModel:
    """Geometry, parametric effects and random effects of a linearised recording under a noise, as one linear problem.

    sigma: (z,) prior of all coefficients: those of the geometry, effect by effect (slices ``effects``), group by group (``groups``).
    """

    def __init__(self, linear: LinearProblem, model: EffectSet, random: Sequence[RandomEffect], whiten: CentreWhitening):
        self.linear, self.model, self.random, self.whiten = linear, model, tuple(random), whiten
        self.known, sigma = columns_of(linear, model)
        first = len(sigma) - sum(m.candidate.k for m in model.members)
        self.effects = [slice(first + p.start, first + p.stop) for p in model.slices()]
        self.groups = [slice(len(sigma) + p.start, len(sigma) + p.stop) for p in coefficients_of(self.random)]
        self.sigma = np.concatenate([sigma, *(g.sigma for g in self.random)])
        self.geometry = np.arange(first)

    def written_columns(self) -> WhitenedColumns:
        """The whitened columns, anew at each call: those of groups are hundreds, as long as the recording."""
        return WhitenedColumns(self.linear, self.whiten, self.known, [g.parts for g in self.random])

    @cached_property
    def columns(self) -> WhitenedColumns:
        return self.written_columns()

    @cached_property
    def products(self) -> ColumnProducts:
        """Products of the columns over all centres that the whitener keeps."""
        return (self.written_columns() if self.random else self.columns).products()

    @cached_property
    def posterior(self) -> Posterior:
        return Posterior(self.sigma, self.products)

    def index(self, effects: Iterable[int], groups: Iterable[int]) -> np.ndarray:
        """The columns of the geometry and of some effects and groups, by their numbers."""
        return np.concatenate([self.geometry, joined([self.effects[j] for j in effects] + [self.groups[g] for g in groups])])

    def displacement(self, solution: np.ndarray) -> np.ndarray:
        """(M, R) by all coefficients (z,)."""
        moved = self.known @ solution[: self.known.shape[2]]
        for group, own in zip(self.random, self.groups, strict=True):
            if np.any(solution[own]):
                moved += self.linear.displacement(group.parts, solution[own])
        return moved

    def left_of(self, moved: np.ndarray) -> np.ndarray:
        """(M, R): what geometry and parametric effects, fitted to a displacement (M, R), leave of it; without groups."""
        X, sigma = self.columns.written[:, :-1], self.sigma
        return moved - self.known @ (sigma * self.posterior.solved(sigma * (X.T @ self.whiten(moved))))

    def slopes(self, groups: Iterable[Sequence[Part]], rows: np.ndarray) -> list[np.ndarray]:
        """(k,) of each group: products of what geometry and parametric effects leave of its columns with rows (M, R); without groups."""
        X, sigma = self.columns.written[:, :-1], self.sigma
        fitted = self.posterior.solved(sigma * np.einsum("mrz,mr->z", self.known, rows))
        left = rows - self.whiten.transpose(X @ (sigma * fitted))
        return [self.linear.products(parts, left) for parts in groups]

    def beyond(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations S (k, k), b (k,) of the other columns, in their order and in units of sigma, when those at ``index`` are fitted
        to each of them; without their prior.
        """
        sigma, products = self.sigma, self.products
        rest = np.setdiff1d(np.arange(len(sigma)), index)
        normal, right = sigma[:, None] * products.information * sigma, sigma * products.right
        root = root_of(sigma[index], products.information[np.ix_(index, index)])
        taken = solve_triangular(root, np.c_[normal[np.ix_(index, rest)], right[index]], lower=True, check_finite=False)
        S = normal[np.ix_(rest, rest)] - taken[:, :-1].T @ taken[:, :-1]
        return S, right[rest] - taken[:, :-1].T @ taken[:, -1]

    @property
    def random_effects(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (k,) of the groups and their covariance (k, k), with geometry and parametric effects free."""
        index = joined(self.groups)
        return self.posterior.solution[index], self.posterior.covariance_of(index)

    def log_bayes_factors(self) -> tuple[float, np.ndarray]:
        """Log Bayes factor of all groups together, and (G,) of each alone, against none, with geometry and parametric effects free."""
        S, b = self.beyond(self.index(range(len(self.effects)), ()))

        def log_factor(own: slice) -> float:
            root = np.linalg.cholesky(S[own, own] + np.eye(own.stop - own.start))
            half = solve_triangular(root, b[own], lower=True)
            return 0.5 * float(half @ half) - float(np.log(np.diag(root)).sum())

        return log_factor(slice(0, len(b))), np.array([log_factor(own) for own in coefficients_of(self.random)])

    def group_sizes(self, start: np.ndarray) -> np.ndarray:
        """(G,) size of each group, in units of its sigma, by which the centres are most probable; zero where the data do not ask for it.
        start: (G,) to begin with.
        """
        known = self.index(range(len(self.effects)), ())
        limits = unmodelled.OPTIONS.smallest, unmodelled.OPTIONS.largest
        return sizes_by_marginal_likelihood(*self.beyond(known), coefficients_of(self.random), start, limits, unmodelled.OPTIONS.ending)


def effect_columns(linear: LinearProblem, model: EffectSet) -> tuple[np.ndarray, np.ndarray]:
    """Parametric effects: columns (M, R, k) and prior sigma (k,)."""
    blocks = [candidate_columns(linear, m.candidate, m.hyper) for m in model.members]
    nothing = np.zeros((*linear.residual.shape, 0))
    return np.concatenate([nothing, *blocks], axis=2), np.concatenate([np.zeros(0), *(prior_sigma(m.candidate) for m in model.members)])


def columns_of(linear: LinearProblem, model: EffectSet) -> tuple[np.ndarray, np.ndarray]:
    """Free geometry and parametric effects together: (M, R, z) and prior sigma (z,)."""
    parts = linear.nuisance(), effect_columns(linear, model)
    return np.concatenate([columns for columns, _ in parts], axis=2), np.concatenate([sigma for _, sigma in parts])


def noise_with(linear: LinearProblem, model: EffectSet, start: Noise, prior: NoisePrior) -> Noise:
    """Restricted maximum likelihood estimate of the noise with a model in place."""
    extended = linear.extended(*effect_columns(linear, model))
    return restricted_maximum_likelihood(lambda noise: extended.at(noise).after_fit(), start, prior)


def conditioned_on_effects(projected: CandidateScoring, model: EffectSet) -> CandidateScoring:
    """The problem with the parametric effects projected out."""
    return projected.conditioned_on([(projected.block(m.candidate, m.hyper), prior_weight(m.candidate)) for m in model.members])
