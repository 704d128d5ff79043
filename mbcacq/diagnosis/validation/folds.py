"""One fold: the whole search repeated without it, and the model so found tried on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.model_fit import ModelFit, find
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import NOTHING, EffectSet
from mbcacq.diagnosis.validation.predictive_score import EMPTY, PredictiveScore, judge


@dataclass(frozen=True)
class FoldResult:
    """before, after: quality on the fold with geometry alone and with the model found without it; the same where the model may be judged
    (``there``). without: the same with one effect left out, by its key. named: with the names alone. picks: names found.
    """

    before: PredictiveScore
    after: PredictiveScore
    before_there: PredictiveScore
    after_there: PredictiveScore
    without: dict[str, PredictiveScore]
    named: PredictiveScore
    picks: tuple[str, ...]


class Fold:
    """What is found without one fold, and its trials on it. keys: effects to be left out in turn; everywhere: groups stand everywhere."""

    def __init__(self, setup: DiagnosisProblem, full: ModelFit, test: np.ndarray, expected: bool):
        """test: (P,) bool, the poses left out."""
        linear = full.before.linear
        self.linear, self.noise = linear, full.noise
        self.train, self.test = linear.keep & ~test[linear.obs.pose], linear.keep & test[linear.obs.pose]
        name_expected = bool(full.model.members) and full.smooth is None
        self.found = find(setup.at(linear), self.train, expected=expected, name_expected=name_expected)

    def judge(self, model: EffectSet, rest: RandomEffectsModel | None, test: np.ndarray | None = None) -> PredictiveScore:
        return judge(self.linear, self.train, self.test if test is None else test, model, rest, self.noise)

    def answer(self, keys: tuple[str, ...], elsewhere: np.ndarray, everywhere: bool) -> FoldResult:
        """elsewhere: (M,) bool of the centres by which the model may be judged."""
        model, rest = self.found.model, self.found.smooth
        before, after = self.judge(NOTHING, None), self.judge(model, rest)
        there = self.test & elsewhere
        partly = there.any() and not elsewhere.all()
        before_there, after_there = (self.judge(NOTHING, None, there), self.judge(model, rest, there)) if partly else (EMPTY, EMPTY)
        whole = self.judge(model, None) if everywhere else after
        without = {}
        for key in keys:
            other, others = less(replace(self.found, smooth=None) if everywhere else self.found, key)
            same = other is model and (everywhere or others is rest)
            without[key] = whole if same else self.judge(other, others)
        return FoldResult(before, after, before_there, after_there, without, whole if everywhere else EMPTY, model.names)

    def without(self, names: tuple[str, ...]) -> PredictiveScore:
        """With these names left out of the model."""
        return self.judge(self.found.model.without(names), self.found.smooth)


def split(linear: LinearProblem, folds: int) -> tuple[np.ndarray, str]:
    """(P,) fold of each pose. Stations go whole; a single station is cut into blocks of its order of measurement."""
    obs = linear.obs
    stations = np.unique(obs.station)
    if len(stations) >= 3:
        size = np.bincount(obs.station, minlength=len(obs.cell.stations))
        kind = np.array([[a.id for a in obs.cell.artefacts].index(s.artefact) for s in obs.cell.stations])
        ranked = sorted(stations, key=lambda k: (kind[k], -size[k], k))
        fold = np.zeros(len(obs.cell.stations), int)
        fold[ranked] = np.arange(len(ranked)) % min(folds, len(ranked))
        return fold[obs.station], "station"
    key = np.arange(obs.n_poses) if obs.time_s is None else np.argsort(np.argsort(obs.time_s, kind="stable"))
    blocks = key * (4 * folds) // obs.n_poses
    return blocks % folds, "block"


def less(part: ModelFit, key: str) -> tuple[EffectSet, RandomEffectsModel | None]:
    """A fold's model without one effect."""
    if key.startswith("unknown:"):
        at = key.removeprefix("unknown:")
        there = part.smooth is not None and any(g.at == at for g in part.smooth.groups)
        return part.model, part.smooth.without(at) if there else part.smooth
    return part.model.without((key,)), part.smooth
