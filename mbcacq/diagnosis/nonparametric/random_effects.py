"""Random effects: the model of what has no parametric effect, groups of functions at locations, each group with a size of its own.

Every group is a random effect u ~ N(0, sigma^2) whose common size maximises the marginal likelihood. Groups that the data do not ask for
vanish, and ranges without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import Part, at_poses


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


@dataclass(frozen=True)
class RandomEffectsModel:
    """Groups with their coefficients (all concatenated). covariance: of the coefficients, with geometry and parametric effects free."""

    groups: tuple[RandomEffect, ...]
    coefficients: np.ndarray
    covariance: np.ndarray

    @property
    def used(self) -> float:
        """Number of coefficients that the data determine."""
        sigma = np.concatenate([g.sigma for g in self.groups])
        return float(np.sum(1.0 - np.diag(self.covariance) / sigma**2))

    def slices(self) -> list[slice]:
        """Which coefficients belong to which group."""
        return slices_of(self.groups)

    def displacement(self, linear: LinearProblem) -> np.ndarray:
        """(M, R) by all groups."""
        each = zip(self.groups, self.slices(), strict=True)
        return sum((linear.displacement(g.parts, self.coefficients[p]) for g, p in each), np.zeros_like(linear.residual))


def slices_of(groups: Sequence[RandomEffect]) -> list[slice]:
    ends = np.cumsum([0] + [len(g.sigma) for g in groups])
    return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
