"""Predictive score of a model: fitted on some centres, evaluated on others, where only the poses of new stations are free.

Squares are of what the fit predicts; chi2 also knows how certain that prediction is. Geometry is never known exactly, and its error is
common to many centres, so a weak effect shows there first. Products of columns that several models of a recording share are computed once
(``SharedProducts``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from mbcacq.diagnosis.nonparametric.joint_model import JointModel, RandomEffect
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects import over_time
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.random_effect_sizes import joined
from mbcacq.estimation.whitened_columns import ColumnProducts, Posterior


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


@dataclass(frozen=True)
class PredictiveScore:
    """Sums over the centres that took part in a fit: squared 3D distances (mm^2), count, chi2 and its degrees of freedom. of_every,
    every: squares and count of all centres of the same poses, those as well that were rejected as gross outliers.
    """

    square: float
    count: int
    chi2: float
    dof: float
    of_every: float = 0.0
    every: int = 0

    def __add__(self, other: PredictiveScore) -> PredictiveScore:
        return PredictiveScore(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def better_than(self, other: PredictiveScore) -> bool:
        """Whether both the misfit and chi2 are smaller: a prediction that is less certain has a smaller chi2 for its uncertainty alone."""
        return self.square < other.square and self.chi2 < other.chi2

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.square / max(self.count, 1)))

    @property
    def rms_of_every(self) -> float:
        return float(np.sqrt(self.of_every / max(self.every, 1)))

    @property
    def chi2_dof(self) -> float:
        return float(self.chi2 / max(self.dof, 1e-9))


NO_CENTRES = PredictiveScore(0.0, 0, 0.0, 0.0)


class HeldOutPrediction:
    """Geometry and the coefficients of a model fitted on train (M,) bool, evaluated on test (M,) bool. Only the stations that are not in
    train are free there, and the moment of a change that fell among the poses left out. All centres of a pose are in train, or all in test.
    """

    def __init__(
        self,
        linear: LinearProblem,
        train: np.ndarray,
        test: np.ndarray,
        model: EffectSet,
        random: Sequence[RandomEffect],
        noise: Noise,
        products: Callable[[JointModel], tuple[ColumnProducts, ColumnProducts]] | None = None,
        every: np.ndarray | None = None,
    ):
        """products: where they are known, those of the columns over the poses of train and over those of test. every: (M,) bool of all
        centres that are judged, test and those that were rejected.
        """
        self.linear, self.train, self.test, self.noise = linear, train, test, noise
        self.every = test if every is None else every
        self.joint = JointModel(linear, model, random, linear.restricted(train | test).whitener(noise))
        self._poses = np.bincount(linear.obs.pose, train, linear.obs.n_poses) > 0
        self._seen, self._others = products(self.joint) if products else self.joint.columns.products_of_parts([self._poses, ~self._poses])

    def score(self, effects: Iterable[int] | None = None, groups: Iterable[int] | None = None) -> PredictiveScore:
        """With geometry and these effects and groups alone, by their numbers, or with all of them."""
        joint, linear = self.joint, self.linear
        chosen = list(range(len(joint.effects)) if effects is None else effects)
        index = joint.index(chosen, range(len(joint.groups)) if groups is None else groups)
        place = np.full(len(joint.sigma), -1)
        place[index] = np.arange(len(index))
        own = [slice(place[p.start], place[p.start] + p.stop - p.start) for p in (joint.effects[j] for j in chosen)]
        typical = [joint.model.members[j].candidate.typical for j in chosen]
        posterior = with_estimated_prior(Posterior(joint.sigma[index], self._seen.of_columns(index)), typical, own)
        solution = np.zeros(len(joint.sigma))
        solution[index] = posterior.solution
        left = linear.residual - joint.displacement(solution)
        best = self._scored(posterior, self._others.of_columns(index), left)
        for j in chosen:
            candidate, hyper = joint.model.members[j].candidate, joint.model.members[j].hyper
            for moment in over_time.indistinguishable_moments(candidate, hyper, linear.obs, self.train):
                changed = candidate_columns(linear, candidate, moment) - joint.known[:, :, joint.effects[j]]
                others = self._with_change(joint.effects[j], changed).of_columns(index)
                best = min(best, self._scored(posterior, others, left - changed @ solution[joint.effects[j]]), key=lambda one: one.chi2)
        return best

    def _scored(self, posterior: Posterior, others: ColumnProducts, left: np.ndarray) -> PredictiveScore:
        """left: (M, R) residual after the solution."""
        score = score_with_new_stations(self.linear, self.train, self.test, left, self.noise, self.every)
        return replace(score, chi2=posterior.predicted(others))

    def _with_change(self, own: slice, changed: np.ndarray) -> ColumnProducts:
        """The products of the centres left out where the columns of one effect change by these (M, R, k)."""
        joint = self.joint
        columns = joint.columns.with_change(own, joint.whiten(changed))
        return columns.products(~self._poses)


def score_with_new_stations(
    linear: LinearProblem, train: np.ndarray, test: np.ndarray, residual: np.ndarray, noise: Noise, every: np.ndarray
) -> PredictiveScore:
    """Residual (M, R) on test after the poses of stations that are not in train are fitted to it; also on every judged centre (M,)."""
    obs = linear.obs
    whiten = linear.restricted(test).whitener(noise)
    new_stations = [k for k in np.unique(obs.station[obs.pose[test]]) if k not in set(obs.station[obs.pose[train]])]
    dof = float(test.sum() * linear.width)
    if new_stations:
        station = linear.station_columns(new_stations)
        Z = whiten(station)
        normal = Z.T @ Z
        fitted = normal + np.eye(len(normal))
        residual = residual - station @ np.linalg.solve(fitted, Z.T @ whiten(residual))
        dof -= float(np.trace(np.linalg.solve(fitted, normal)))
    r = whiten(residual)
    square, of_every = (float(np.sum(residual[some, :3] ** 2)) for some in (test, every))
    return PredictiveScore(square, int(test.sum()), float(r @ r), dof, of_every, int(every.sum()))


def training_score(joint: JointModel) -> tuple[PredictiveScore, np.ndarray]:
    """The score on the data fitted, and the residual (M, R)."""
    linear, posterior = joint.linear, joint.posterior
    keep = linear.keep
    residual = linear.residual - joint.displacement(posterior.solution)
    dof = keep.sum() * linear.width - posterior.determined
    r = joint.whiten(residual)
    return PredictiveScore(float(np.sum(residual[keep, :3] ** 2)), int(keep.sum()), float(r @ r), dof), residual


class SharedProducts:
    """Products over each of some parts of the poses. joint: of the fit of all data, in whose linearisation and under whose noise all is;
    its own products follow.

    Groups at all locations have a hundred times as many columns as effects. Without a part of the poses only their sizes change.
    """

    def __init__(self, joint: JointModel, models: Sequence[tuple[EffectSet, Sequence[RandomEffect]]], left_out: Sequence[np.ndarray]):
        """models: found without each part; left_out: (P,) bool of each."""
        self.linear, self.left_out = joint.linear, left_out
        every = [(joint.model, joint.random), *models]
        effects = {(m.candidate.key, m.hyper): m for model, _ in every for m in model.members}
        groups = {id(g.parts): g for _, random in every for g in random}
        together = JointModel(joint.linear, EffectSet(tuple(effects.values())), tuple(groups.values()), joint.whiten)
        self._parts = together.columns.products_of_parts(left_out)
        self._geometry = together.geometry
        self._own = dict(zip((*effects, *groups), (*together.effects, *together.groups), strict=True))
        joint.products = self.of(joint, range(len(left_out)))

    def of(self, joint: JointModel, parts: Iterable[int]) -> ColumnProducts:
        """The products of the columns of one of the models, over some parts."""
        own = [*((m.candidate.key, m.hyper) for m in joint.model.members), *(id(g.parts) for g in joint.random)]
        index = np.concatenate([self._geometry, *(np.arange(self._own[key].start, self._own[key].stop) for key in own)])
        return reduce(add, (self._parts[number].of_columns(index) for number in parts))

    def held_out(self, number: int, model: EffectSet, random: Sequence[RandomEffect], noise: Noise) -> HeldOutPrediction:
        """The prediction of a part by the model found without it."""
        keep, test = self.linear.keep, self.left_out[number][self.linear.obs.pose]
        others = [part for part in range(len(self.left_out)) if part != number]

        def products(joint: JointModel) -> tuple[ColumnProducts, ColumnProducts]:
            return self.of(joint, others), self.of(joint, [number])

        return HeldOutPrediction(self.linear, keep & ~test, keep & test, model, random, noise, products, every=test)
