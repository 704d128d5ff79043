"""One fold: the whole search repeated without it, and the model so found evaluated on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
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
    (``there``). without: the same without one effect, by its key. parametric: without random effects.
    """

    before: PredictiveScore
    after: PredictiveScore
    before_there: PredictiveScore
    after_there: PredictiveScore
    without: dict[str, PredictiveScore]
    parametric: PredictiveScore


class Fold:
    """The model found without one fold, and its scores on it."""

    def __init__(self, problem: DiagnosisProblem, noise: Noise, test: np.ndarray, structure_expected: bool):
        """problem: linearised at the fit of all data; noise: of that fit; test: (P,) bool, the poses left out."""
        linear = problem.linear
        self.linear, self.noise = linear, noise
        self.train, self.test = linear.keep & ~test[linear.obs.pose], linear.keep & test[linear.obs.pose]
        self.found = fit_model(problem, self.train, structure_expected=structure_expected)

    def score(self, model: EffectSet, smooth: RandomEffectsModel | None, test: np.ndarray | None = None) -> PredictiveScore:
        return held_out_score(self.linear, self.train, self.test if test is None else test, model, smooth, self.noise)

    def evaluate(self, keys: tuple[str, ...], elsewhere: np.ndarray, everywhere: bool) -> FoldResult:
        """keys: effects to be left out in turn; elsewhere: (M,) bool of the centres by which the model may be judged; everywhere: random
        effects stand at all locations.
        """
        model, smooth = self.found.model, self.found.smooth
        before, after = self.score(NO_EFFECTS, None), self.score(model, smooth)
        there = self.test & elsewhere
        partly = there.any() and not elsewhere.all()
        before_there, after_there = NO_CENTRES, NO_CENTRES
        if partly:
            before_there, after_there = self.score(NO_EFFECTS, None, there), self.score(model, smooth, there)
        whole = self.score(model, None) if everywhere else after
        without = {}
        for key in keys:
            other, others = without_effect(replace(self.found, smooth=None) if everywhere else self.found, key)
            same = other is model and (everywhere or others is smooth)
            without[key] = whole if same else self.score(other, others)
        return FoldResult(before, after, before_there, after_there, without, whole if everywhere else NO_CENTRES)

    def without(self, names: tuple[str, ...]) -> PredictiveScore:
        """Score of the model without these effects."""
        return self.score(self.found.model.without(names), self.found.smooth)


def evaluated_fold(
    problem: DiagnosisProblem,
    noise: Noise,
    test: np.ndarray,
    structure_expected: bool,
    keys: tuple[str, ...],
    elsewhere: np.ndarray,
    everywhere: bool,
) -> FoldResult:
    """``Fold`` and its evaluation in one call, which a worker process can do."""
    return Fold(problem, noise, test, structure_expected).evaluate(keys, elsewhere, everywhere)


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


def without_effect(found: ModelFit, key: str) -> tuple[EffectSet, RandomEffectsModel | None]:
    """A fold's model without one effect."""
    if key.startswith("unknown:"):
        location = key.removeprefix("unknown:")
        there = found.smooth is not None and any(g.location == location for g in found.smooth.groups)
        return found.model, found.smooth.without(location) if found.smooth is not None and there else found.smooth
    return found.model.without((key,)), found.smooth
