"""How well a model does on centres: fitted on some, looked at on others, where only the poses of new stations are free.

Squares and chi2 are of what the fit on the others predicts. ``surprise`` also knows how sure that prediction is: minus twice the log of the
probability density of the centres looked at, given the others. Geometry is never known exactly, and its error is common to many centres,
so a weak effect shows there first.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric.joint_model import columns_of
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.posterior import Posterior
from mbcacq.effects.pose import steps


@dataclass(frozen=True)
class PredictiveScore:
    """Sums over centres: squared 3D distances (mm^2), count, chi2 and its degrees of freedom; surprise, see above, up to a constant."""

    square: float
    count: int
    chi2: float
    dof: float
    surprise: float = 0.0

    def __add__(self, other: PredictiveScore) -> PredictiveScore:
        return PredictiveScore(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.square / max(self.count, 1)))

    @property
    def chi2_dof(self) -> float:
        return float(self.chi2 / max(self.dof, 1e-9))


EMPTY = PredictiveScore(0.0, 0, 0.0, 0.0)
NOISE_LIKE = 1.5  # held-out chi2 per degree of freedom up to which a model may be said to leave only noise


def better(one: PredictiveScore, other: PredictiveScore) -> bool:
    """Whether one model does better on data left out than another: makes them more probable, or, where it leaves more than noise and so
    cannot say how probable anything is, predicts them more closely.
    """
    return one.surprise < other.surprise if one.chi2_dof <= NOISE_LIKE else one.chi2 < other.chi2


def judge(
    linear: LinearProblem, train: np.ndarray, test: np.ndarray, model: EffectSet, rest: RandomEffectsModel | None, noise: NoiseEstimate
) -> PredictiveScore:
    """Fit geometry and the model's coefficients on train, look at test, where only stations unseen in training are free, and the moment of
    a change that fell among the poses left out.
    """
    columns, sigma = columns_of(linear.restricted(train), model, rest)
    parts = places_of(model, columns.shape[2] - (0 if rest is None else rest.columns.shape[2]))
    known = Posterior.of(linear.restricted(train).whitener(noise), columns, sigma, linear.residual).sized(model, parts)
    looked_at = linear.restricted(test).whitener(noise)

    def seen(columns: np.ndarray) -> PredictiveScore:
        quality = on_new_stations(linear, train, test, linear.residual - columns @ known.solution, noise)
        return replace(quality, surprise=known.surprise(looked_at, columns, linear.residual))

    best = seen(columns)
    for (candidate, hyper), mine in zip(model.members, parts, strict=True):
        for moment in steps.indistinguishable_moments(candidate, hyper, linear.obs, train):
            other = columns.copy()
            other[:, :, mine] = linear.columns(candidate.build(moment))
            best = min(best, seen(other), key=lambda quality: quality.chi2)
    return best


def places_of(model: EffectSet, end: int) -> list[slice]:
    """Which columns are which member's, if the last one's end there."""
    first = end - sum(c.k for c, _ in model.members)
    return [slice(first + p.start, first + p.stop) for p in model.parts()]


def on_new_stations(linear: LinearProblem, train: np.ndarray, test: np.ndarray, left: np.ndarray, noise: NoiseEstimate) -> PredictiveScore:
    """Residual (M, R) on test after the poses of stations that training has not seen are fitted to it."""
    obs = linear.obs
    whiten = linear.restricted(test).whitener(noise)
    unseen = [k for k in np.unique(obs.station[obs.pose[test]]) if k not in set(obs.station[obs.pose[train]])]
    dof = float(test.sum() * linear.width)
    if unseen:
        columns, sigma, layout = linear.nuisance()
        position = {k: j for j, k in enumerate(np.unique(obs.station))}
        free = np.concatenate(
            [np.arange(layout.stations.start + 6 * position[k], layout.stations.start + 6 * position[k] + 6) for k in unseen]
        )
        station, width = columns[:, :, free], sigma[free]
        Z = whiten(station) * width
        normal = Z.T @ Z
        left = left - station @ (width * np.linalg.solve(normal + np.eye(len(free)), Z.T @ whiten(left)))
        dof -= float(np.trace(np.linalg.solve(normal + np.eye(len(free)), normal)))
    r = whiten(left)
    return PredictiveScore(float(np.sum(left[test, :3] ** 2)), int(test.sum()), float(r @ r), dof)


def on_train(screen: CandidateScoring, model: EffectSet, rest: RandomEffectsModel | None) -> tuple[PredictiveScore, np.ndarray]:
    """The same on the data fitted, and the residual (M, R)."""
    linear = screen.linear
    columns, sigma = columns_of(linear, model, rest)
    Z = screen.whiten(columns) * sigma
    normal = Z.T @ Z
    inverse = np.linalg.inv(normal + np.eye(len(sigma)))
    solution = sigma * (inverse @ (Z.T @ screen.r0))
    left = linear.residual - columns @ solution
    keep = linear.keep
    dof = keep.sum() * linear.width - float(np.sum(inverse * normal))
    r = screen.whiten(left)
    return PredictiveScore(float(np.sum(left[keep, :3] ** 2)), int(keep.sum()), float(r @ r), dof), left
