"""Random effects: the model of what has no parametric effect, groups of functions at locations, each group with a size of its own.

Every group is a random effect u ~ N(0, size^2 diag(weight^2)) whose size maximises the marginal likelihood: groups that the data do not
ask for vanish, and ranges without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.random_effect_sizes import joined, posterior_of, sizes_by_marginal_likelihood
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class RandomEffect:
    """location, depends_on: for the report. columns: (M, R, k); weight: (k,) relative prior sigma, falling with the order."""

    location: str
    depends_on: str
    columns: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class RandomEffectOfPose:
    """A random effect before its columns are computed, which take much memory: a group of ``mbcacq.effects.unmodelled`` at the poses of a
    recording. weight: (k,) relative prior sigma.
    """

    location: str
    depends_on: str
    parts: tuple[Part, ...]
    weight: np.ndarray

    @classmethod
    def of(cls, here: Covariates, group: EffectTerm) -> RandomEffectOfPose:
        """The group at all poses of a recording."""
        return cls(group.where[0], group.depends_on, tuple(evaluated(here, group.parts)), group.sigma)

    def on(self, linear: LinearProblem, whole: Observations, poses: np.ndarray | None = None) -> RandomEffect:
        """Its columns at the poses of a linearisation, which are these (P,) bool of the whole recording's."""
        parts = self.parts
        if poses is not None:
            parts = tuple(replace(p, basis=p.basis[poses if p.place in PER_POSE else poses[whole.pose]]) for p in parts)
        return RandomEffect(self.location, self.depends_on, linear.columns(parts), self.weight)


@dataclass(frozen=True)
class RandomEffectsModel:
    """Groups with coefficients and prior sigmas (all concatenated), the size of each group. used: coefficients that the data determine.
    covariance: of the coefficients, with geometry and parametric effects free.
    """

    groups: tuple[RandomEffect, ...]
    coefficients: np.ndarray
    sigma: np.ndarray
    sizes: np.ndarray
    used: float
    covariance: np.ndarray

    @property
    def columns(self) -> np.ndarray:
        return np.concatenate([g.columns for g in self.groups], axis=2)

    def without(self, location: str) -> RandomEffectsModel | None:
        """The groups that are not at a location; None where none is left."""
        chosen = [g for g, group in enumerate(self.groups) if group.location != location]
        if not chosen:
            return None
        index = joined([self.slices()[g] for g in chosen])
        groups = tuple(self.groups[g] for g in chosen)
        own = np.ix_(index, index)
        return RandomEffectsModel(groups, self.coefficients[index], self.sigma[index], self.sizes[chosen], self.used, self.covariance[own])

    def slices(self) -> list[slice]:
        """Which coefficients belong to which group."""
        return slices_of(self.groups)


def slices_of(groups: Sequence[RandomEffect]) -> list[slice]:
    ends = np.cumsum([0] + [len(g.weight) for g in groups])
    return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]


@dataclass(frozen=True)
class _NormalEquations:
    """Of the groups' coefficients beyond what is projected out, in units of ``scale`` (k,)."""

    groups: tuple[RandomEffect, ...]
    scale: np.ndarray
    S: np.ndarray
    b: np.ndarray

    @classmethod
    def of(cls, projected: CandidateScoring, groups: Sequence[RandomEffect]) -> _NormalEquations:
        scale = np.concatenate([unit_weight(projected, g) for g in groups])
        X = np.concatenate([projected.whiten(g.columns) for g in groups], axis=1)
        X *= scale
        absorbed = projected.all_projected.T @ X
        return cls(tuple(groups), scale, X.T @ X - absorbed.T @ absorbed, X.T @ projected.r)

    def solved(self, sizes: np.ndarray) -> RandomEffectsModel | None:
        """The coefficients with these sizes (G,); None where all are zero."""
        chosen = [int(g) for g in np.flatnonzero(sizes > 0)]
        if not chosen:
            return None
        slices = slices_of(self.groups)
        index = joined([slices[g] for g in chosen])
        prior = np.concatenate([np.full(slices[g].stop - slices[g].start, sizes[g] ** 2) for g in chosen])
        mean, half = posterior_of(self.S[np.ix_(index, index)], self.b[index], prior)
        covariance = half.T @ half
        used = float(np.sum(1.0 - np.diag(covariance) / prior))
        scale, groups = self.scale[index], tuple(self.groups[g] for g in chosen)
        covariance *= np.outer(scale, scale)
        return RandomEffectsModel(groups, mean * scale, np.sqrt(prior) * scale, sizes[chosen], used, covariance)


def fit_random_effects(projected: CandidateScoring, groups: Sequence[RandomEffect], start: np.ndarray) -> RandomEffectsModel | None:
    """Sizes and coefficients of the groups beyond what is projected out; None where the data ask for none. start: (G,) initial sizes."""
    if not groups:
        return None
    system = _NormalEquations.of(projected, groups)
    smallest = OPTIONS.smallest_size * float(np.mean(projected.noise.point))
    limits = smallest, OPTIONS.largest_size_mm
    return system.solved(sizes_by_marginal_likelihood(system.S, system.b, slices_of(groups), start, limits, OPTIONS.size_rounds))


def solve_random_effects(projected: CandidateScoring, groups: Sequence[RandomEffect], sizes: np.ndarray) -> RandomEffectsModel | None:
    """Coefficients of groups of given sizes (G,)."""
    return _NormalEquations.of(projected, groups).solved(sizes) if groups else None


def unit_weight(projected: CandidateScoring, group: RandomEffect) -> np.ndarray:
    """(k,) weights with which a group of unit size moves the centres by about a millimetre, or turns the target by a mrad, so that sizes
    compare.
    """
    moved = (group.columns * group.weight)[projected.linear.keep]
    size = np.sqrt(np.mean(moved[:, :3] ** 2) * moved.shape[2])
    if size == 0 and moved.shape[1] > 3:  # only the orientation is turned
        size = 1e3 * np.sqrt(np.mean(moved[:, 3:] ** 2) * moved.shape[2])
    return group.weight / max(float(size), 1e-12)
