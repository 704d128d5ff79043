"""One fold: the whole search repeated without it, and the model so found evaluated on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.diagnosis.validation.predictive_score import NO_CENTRES, PredictiveScore, held_out_score
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise


@dataclass(frozen=True)
class FoldResult:
    """before, after: score on the fold with geometry alone and with the model found without it; the same where the model may be judged
    (``there``). without: the same without one effect, by its key. parametric: without random effects. model, smooth: what was found.
    """

    before: PredictiveScore
    after: PredictiveScore
    before_there: PredictiveScore
    after_there: PredictiveScore
    without: dict[str, PredictiveScore]
    parametric: PredictiveScore
    model: EffectSet
    smooth: RandomEffectsModel | None


@dataclass(frozen=True)
class Fold:
    """One fold. linear: of the fit of all data, noise: of that fit; test: (P,) bool, the poses left out."""

    linear: LinearProblem
    noise: Noise
    test: np.ndarray

    @property
    def train(self) -> np.ndarray:
        """(M,) bool of the centres of the other poses."""
        return self.linear.keep & ~self.test[self.linear.obs.pose]

    @property
    def left_out(self) -> np.ndarray:
        """(M,) bool of the centres of the poses left out."""
        return self.linear.keep & self.test[self.linear.obs.pose]

    def score(self, model: EffectSet, smooth: RandomEffectsModel | None, test: np.ndarray | None = None) -> PredictiveScore:
        return held_out_score(self.linear, self.train, self.left_out if test is None else test, model, smooth, self.noise)


def evaluated_fold(
    problem: DiagnosisProblem,
    noise: Noise,
    test: np.ndarray,
    structure_expected: bool,
    keys: tuple[str, ...],
    elsewhere: np.ndarray,
    everywhere: bool,
) -> FoldResult:
    """The model found without a fold, and its scores on it, in one call, which a worker process can do.

    problem: linearised at the fit of all data; noise: of that fit; test: (P,) bool, the poses left out. keys: effects to be left out in
    turn; elsewhere: (M,) bool of the centres by which the model may be judged; everywhere: random effects stand at all locations.
    """
    fold = Fold(problem.linear, noise, test)
    found = fit_model(problem, fold.train, structure_expected=structure_expected)
    model, smooth = found.model, found.smooth
    before, after = fold.score(NO_EFFECTS, None), fold.score(model, smooth)
    there = fold.left_out & elsewhere
    before_there, after_there = NO_CENTRES, NO_CENTRES
    if there.any() and not elsewhere.all():
        before_there, after_there = fold.score(NO_EFFECTS, None, there), fold.score(model, smooth, there)
    whole = fold.score(model, None) if everywhere else after
    without = {}
    for key in keys:
        other, others = without_effect(model, None if everywhere else smooth, key)
        same = other is model and (everywhere or others is smooth)
        without[key] = whole if same else fold.score(other, others)
    parametric = whole if everywhere else NO_CENTRES
    return FoldResult(before, after, before_there, after_there, without, parametric, model, smooth)


def split(linear: LinearProblem, folds: int) -> tuple[np.ndarray, str]:
    """(P,) fold of each pose, and what was left out. Stations go whole, also where there are two; a single one is cut into blocks of its
    order of measurement."""
    obs = linear.obs
    stations = np.unique(obs.station)
    if len(stations) >= 2:
        size = np.bincount(obs.station, minlength=len(obs.cell.stations))
        kind = np.array([[a.id for a in obs.cell.artefacts].index(s.artefact) for s in obs.cell.stations])
        ranked = sorted(stations, key=lambda k: (kind[k], -size[k], k))
        fold = np.zeros(len(obs.cell.stations), int)
        fold[ranked] = np.arange(len(ranked)) % min(folds, len(ranked))
        return fold[obs.station], "station"
    key = np.arange(obs.n_poses) if obs.time_s is None else np.argsort(np.argsort(obs.time_s, kind="stable"))
    blocks = key * (4 * folds) // obs.n_poses
    return blocks % folds, "block"


def without_effect(model: EffectSet, smooth: RandomEffectsModel | None, key: str) -> tuple[EffectSet, RandomEffectsModel | None]:
    """A fold's model without one effect."""
    if key.startswith("unknown:"):
        location = key.removeprefix("unknown:")
        there = smooth is not None and any(g.location == location for g in smooth.groups)
        return model, smooth.without(location) if smooth is not None and there else smooth
    return model.without((key,)), smooth
