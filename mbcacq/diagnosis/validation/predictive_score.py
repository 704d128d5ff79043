"""Predictive score of a model: fitted on some centres, evaluated on others, where only the poses of new stations are free.

Squares are of what the fit predicts; chi2 and ``negative_log_predictive_density`` also know how certain that prediction is. Geometry is
never known exactly, and its error is common to many centres, so a weak effect shows there first.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np

from mbcacq.diagnosis.nonparametric.joint_model import columns_of
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.posterior import Posterior
from mbcacq.effects.pose import steps
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise


@dataclass(frozen=True)
class PredictiveScore:
    """Sums over centres: squared 3D distances (mm^2), count, chi2 and its degrees of freedom, and minus twice the log of the probability
    density of the centres given those fitted, up to a constant.
    """

    square: float
    count: int
    chi2: float
    dof: float
    negative_log_predictive_density: float = 0.0

    def __add__(self, other: PredictiveScore) -> PredictiveScore:
        return PredictiveScore(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.square / max(self.count, 1)))

    @property
    def chi2_dof(self) -> float:
        return float(self.chi2 / max(self.dof, 1e-9))


NO_CENTRES = PredictiveScore(0.0, 0, 0.0, 0.0)


def predicts_better(one: PredictiveScore, other: PredictiveScore) -> bool:
    """Whether one model does better on data left out than another: makes them more probable, or, where it leaves more than noise and so
    its density means nothing, predicts them more closely.
    """
    if one.chi2_dof <= OPTIONS.noise_like_chi2:
        return one.negative_log_predictive_density < other.negative_log_predictive_density
    return one.chi2 < other.chi2


def held_out_score(
    linear: LinearProblem, train: np.ndarray, test: np.ndarray, model: EffectSet, smooth: RandomEffectsModel | None, noise: Noise
) -> PredictiveScore:
    """Fit geometry and the model's coefficients on train (M,) bool, evaluate on test (M,) bool, where only the stations that are not in
    train are free, and the moment of a change that fell among the poses left out.
    """
    columns, sigma = columns_of(linear.restricted(train), model, smooth)
    slices = effect_columns(model, columns.shape[2] - (0 if smooth is None else smooth.columns.shape[2]))
    fitted = linear.restricted(train).whitener(noise)
    posterior = Posterior.of(fitted, columns, sigma, linear.residual).with_estimated_prior(model, slices)
    whiten = linear.restricted(test).whitener(noise)

    def score(columns: np.ndarray) -> PredictiveScore:
        with_stations = score_with_new_stations(linear, train, test, linear.residual - columns @ posterior.solution, noise)
        chi2, log_det = posterior.predicted(whiten, columns, linear.residual)
        return replace(with_stations, chi2=chi2, negative_log_predictive_density=chi2 + log_det)

    best = score(columns)
    for (candidate, hyper), own in zip(model.effects, slices, strict=True):
        for moment in steps.indistinguishable_moments(candidate, hyper, linear.obs, train):
            other = columns.copy()
            other[:, :, own] = linear.columns(candidate.build(moment))
            best = min(best, score(other), key=lambda one: one.chi2)
    return best


def effect_columns(model: EffectSet, end: int) -> list[slice]:
    """Which columns are which effect's, if the last one's end there."""
    first = end - sum(c.k for c, _ in model.effects)
    return [slice(first + p.start, first + p.stop) for p in model.slices()]


def score_with_new_stations(
    linear: LinearProblem, train: np.ndarray, test: np.ndarray, residual: np.ndarray, noise: Noise
) -> PredictiveScore:
    """Residual (M, R) on test after the poses of stations that are not in train are fitted to it."""
    obs = linear.obs
    whiten = linear.restricted(test).whitener(noise)
    new_stations = [k for k in np.unique(obs.station[obs.pose[test]]) if k not in set(obs.station[obs.pose[train]])]
    dof = float(test.sum() * linear.width)
    if new_stations:
        station, width = linear.station_columns(new_stations)
        Z = whiten(station) * width
        normal = Z.T @ Z
        residual = residual - station @ (width * np.linalg.solve(normal + np.eye(len(width)), Z.T @ whiten(residual)))
        dof -= float(np.trace(np.linalg.solve(normal + np.eye(len(width)), normal)))
    r = whiten(residual)
    return PredictiveScore(float(np.sum(residual[test, :3] ** 2)), int(test.sum()), float(r @ r), dof)


def training_score(projected: CandidateScoring, model: EffectSet, smooth: RandomEffectsModel | None) -> tuple[PredictiveScore, np.ndarray]:
    """The score on the data fitted, and the residual (M, R)."""
    linear = projected.linear
    columns, sigma = columns_of(linear, model, smooth)
    Z = projected.whiten(columns) * sigma
    normal = Z.T @ Z
    inverse = np.linalg.inv(normal + np.eye(len(sigma)))
    solution = sigma * (inverse @ (Z.T @ projected.r0))
    residual = linear.residual - columns @ solution
    keep = linear.keep
    dof = keep.sum() * linear.width - float(np.sum(inverse * normal))
    r = projected.whiten(residual)
    return PredictiveScore(float(np.sum(residual[keep, :3] ** 2)), int(keep.sum()), float(r @ r), dof), residual
