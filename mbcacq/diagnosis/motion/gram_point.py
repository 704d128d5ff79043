"""The rows of a motion as the evidence sees them: Gram matrices of a group of channels at one noise.

Every joint has a noise of its own, and neighbouring samples are alike, so that one of ``colour`` samples counts. The normal likelihood of
all samples of a joint, to the power of one over its colour, is that of so many fewer independent ones; the weights by which coefficients
are fitted are the same. Offsets and the inertial parameters of the links are integrated over their priors, as the geometry of poses is. A
delay of the channel is a hyper-parameter: sets with it explain the corrected recording, all others the recording as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import solve_triangular

from mbcacq.diagnosis.evidence.hypothesis import NormalSystem
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.normal_store import weighted_sum
from mbcacq.diagnosis.motion.options import RIDGE
from mbcacq.diagnosis.search.effect_set import EffectSet, Member, typical_sizes

# Signal to noise ratios of a coefficient without a prior of its own: from one that is barely seen to a set point that repeats to the last
# digit, half a decade apart. A coefficient with a prior has shares of its standard deviation (as for the sizes of poses, equally probable).
RATIOS = tuple(float(s) for s in 10.0 ** np.linspace(0.15, 8.0, 16))
SHARES = (0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True, eq=False)
class GramProblem:
    """A group of channels at one linearisation.

    numbers[j], gram[j], late[j]: the columns of each joint, mismatch first, their products over all segments divided by the colour, and
    the products (c,) of the mismatch as it was recorded. count (J,): samples that count; least (J,): smallest variance of a channel's
    noise. base: columns that are always there; prior (P,): standard deviation of each column's coefficient. delay: columns of the effect
    that shifts the channel.
    """

    numbers: tuple[np.ndarray, ...]
    gram: tuple[np.ndarray, ...]
    late: tuple[np.ndarray, ...]
    count: np.ndarray
    least: np.ndarray
    base: np.ndarray
    prior: np.ndarray

    @classmethod
    def of(cls, model: MotionModel, colour: np.ndarray) -> GramProblem:
        """colour: (J,) samples that count as one."""
        store = model.store
        joints = range(len(store.numbers))
        gram = tuple(store.total(j) / colour[j] for j in joints)
        count = np.maximum(store.count.sum(axis=0), 1.0) / colour
        base = np.asarray(store.base, dtype=int)
        late = tuple(store.uncorrected(j) / colour[j] for j in joints)
        return cls(tuple(store.numbers), gram, late, count, model.least_noise**2, base, np.array(store.prior))

    def recoloured(self, ratio: np.ndarray) -> GramProblem:
        """The same where ratio (J,) times as many samples count as one."""
        scaled = ([one / r for one, r in zip(each, ratio, strict=True)] for each in (self.gram, self.late))
        gram, late = (tuple(one) for one in scaled)
        return replace(self, gram=gram, late=late, count=self.count / ratio)

    def weighted(self, weights: np.ndarray, corrected: bool) -> np.ndarray:
        """(P + 1, P + 1) normal matrix of all columns, mismatch last. corrected: for its delay."""
        each = [self._with_mismatch(gram, late, corrected) for gram, late in zip(self.gram, self.late, strict=True)]
        return weighted_sum(self.numbers, each, weights, len(self.prior))

    def restricted(self, ids: np.ndarray, corrected: bool) -> np.ndarray:
        """(J, c + 1, c + 1) products of these columns by joint, mismatch last."""
        out = np.zeros((len(self.numbers), len(ids) + 1, len(ids) + 1))
        position = np.full(len(self.prior) + 1, -1)
        position[ids], position[-1] = np.arange(len(ids)), len(ids)
        for j, numbers in enumerate(self.numbers):
            own = np.flatnonzero(position[numbers] >= 0)
            at = position[numbers[own]]
            gram = self._with_mismatch(self.gram[j][np.ix_(own, own)], self.late[j][own], corrected)
            out[j][np.ix_(at, at)] = gram
        return out

    @staticmethod
    def _with_mismatch(gram: np.ndarray, late: np.ndarray, corrected: bool) -> np.ndarray:
        if corrected:
            return gram
        out = gram.copy()
        out[0], out[:, 0] = late, late
        return out


@dataclass(frozen=True, eq=False)
class GramPoint:
    """A group of channels at one noise; theta: (J,) logarithms of the variances."""

    problem: GramProblem
    theta: np.ndarray

    @property
    def base_weight(self) -> np.ndarray:
        """Prior weights of the columns that are always there."""
        return self.problem.prior[self.problem.base] ** -2.0

    def extended(self, members: Sequence[Member]) -> np.ndarray:
        """(J, c + 1, c + 1) Gram matrices of the base and of effects, the latter in typical sizes, mismatch last."""
        problem = self.problem
        ids = np.concatenate([problem.base, *(m.columns for m in members)]).astype(int)
        scale = np.concatenate([np.ones(len(problem.base)), typical_sizes(members), [1.0]])
        return problem.restricted(ids, corrected(members)) * np.outer(scale, scale)

    def with_effects(self, extended: np.ndarray) -> NormalSystem:
        """The normal equations of effects beyond the base. extended: Gram matrices with their columns."""
        normal, g = np.einsum("j,jab->ab", np.exp(-self.theta), extended), len(self.problem.base)
        root = cholesky_of(normal[:g, :g], self.base_weight)
        reduced = solve_triangular(root, normal[:g, g:], lower=True, check_finite=False)
        rest = normal[g:, g:] - reduced.T @ reduced
        floor = float(self.problem.count @ (self.problem.least * np.exp(-self.theta)))
        log_det = float(self.problem.count @ self.theta) + 2.0 * float(np.log(np.diag(root)).sum())
        log_likelihood = -0.5 * (log_det + float(rest[-1, -1]) + floor)
        return NormalSystem(rest[:-1, :-1], rest[:-1, -1], log_likelihood, partial(self.score, extended))

    def score(self, gram: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and information of the log likelihood by theta, with the effects in place. weight (k,): prior weight of each."""
        problem, inverse_variance = self.problem, np.exp(-self.theta)
        normal = np.einsum("j,jab->ab", inverse_variance, gram)
        root = cholesky_of(normal[:-1, :-1], np.r_[self.base_weight, weight])
        inverse = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
        covariance = inverse.T @ inverse
        residual = np.append(-covariance @ normal[:-1, -1], 1.0)
        squares = inverse_variance * (np.einsum("a,jab,b->j", residual, gram, residual) + problem.count * problem.least)
        spent = inverse_variance * np.einsum("jab,ab->j", gram[:, :-1, :-1], covariance)
        gradient = 0.5 * (squares + spent - problem.count)
        return gradient, np.diag(0.5 * np.maximum(problem.count - spent, 0.1 * problem.count))

    def solved(self, members: Sequence[Member]) -> EffectSet:
        """These effects with the posterior of their coefficients, offsets and masses integrated out."""
        system = self.with_effects(self.extended(members))
        return EffectSet.of(members, system.A, system.a)

    def conditioned(self, members: Sequence[Member]) -> ConditionedGram:
        return ConditionedGram.of(self, members)

    def forget(self) -> None:
        """Its normal equations are small and shared with every other point."""

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[GramPoint, np.ndarray]:
        """The variance of each joint by what its residual and the uncertainty of the coefficients add up to (expectation maximisation)."""
        del information
        step = np.log(np.maximum(1.0 + 2.0 * gradient / self.problem.count, 1e-12))
        return replace(self, theta=self.theta + step), step


def corrected(members: Sequence[Member]) -> bool:
    """Whether a set has the effect that corrects the channel's delay."""
    return any(m.candidate.rows.channel_delay for m in members)


def cholesky_of(normal: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Lower factor with prior weights; what neither data nor prior determine is held by a ridge far below the rest."""
    A = normal + np.diag(weight)
    return np.linalg.cholesky(A + np.diag(RIDGE * np.diag(A) + 1e-300))


@dataclass(frozen=True, eq=False)
class ConditionedGram:
    """The normal equations of all columns beyond the base and the effects of a set."""

    normal: np.ndarray
    absorbed: np.ndarray

    @classmethod
    def of(cls, point: GramPoint, members: Sequence[Member]) -> ConditionedGram:
        problem = point.problem
        normal = problem.weighted(np.exp(-point.theta), corrected(members))
        ids = np.concatenate([problem.base, *(m.columns for m in members)]).astype(int)
        known = [(m.size * m.candidate.typical) ** -2.0 for m in members]
        root = cholesky_of(normal[np.ix_(ids, ids)], np.concatenate([point.base_weight, *known]))
        return cls(normal, solve_triangular(root, normal[ids], lower=True, check_finite=False))

    def beyond(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices (H, k, k) and right-hand sides (H, k) of blocks of columns (H, k)."""
        absorbed = self.absorbed[:, ids]  # (c, H, k)
        A = self.normal[ids[:, :, None], ids[:, None, :]] - np.einsum("chk,chl->hkl", absorbed, absorbed)
        return A, self.normal[ids, -1] - np.einsum("chk,c->hk", absorbed, self.absorbed[:, -1])
