"""One fold: the whole search repeated without it, and the model so found evaluated on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.model_fit import fit_part
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.predictive_score import HeldOutPrediction, PredictiveScore
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise


@dataclass(frozen=True)
class FoldResult:
    """before, after: score on the fold with geometry alone and with the model found without it. without: the same without one effect, by
    its key. parametric: without random effects.
    """

    before: PredictiveScore
    after: PredictiveScore
    without: dict[str, PredictiveScore]
    parametric: PredictiveScore


def evaluated_fold(
    problem: DiagnosisProblem, noise: Noise, test: np.ndarray, unmodelled: bool, keys: tuple[str, ...], everywhere: bool
) -> FoldResult:
    """The model found without a fold, and its scores on it, in one call, which a worker process can do.

    problem: linearised at the fit of all data; noise: of that fit; test: (P,) bool, the poses left out. unmodelled: whether there is more
    than effects of the catalogue. keys: effects to be left out in turn; everywhere: random effects stand at all locations.
    """
    linear, left_out = problem.linear, test[problem.linear.obs.pose]
    train = linear.keep & ~left_out
    model, random = fit_part(problem, train, unmodelled)
    held = HeldOutPrediction(linear, train, linear.keep & left_out, model, random, noise)
    after = held.score()
    whole = held.score(groups=()) if everywhere else after
    without = {}
    for key in keys:
        effects, groups = all_but(model, () if everywhere else random, key)
        same = len(effects) == len(model.members) and (everywhere or len(groups) == len(random))
        without[key] = whole if same else held.score(effects, groups)
    return FoldResult(held.score((), ()), after, without, whole)


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


def all_but(model: EffectSet, random: Sequence[RandomEffect], key: str) -> tuple[list[int], list[int]]:
    """Numbers of the effects and groups of a fold's model without one effect."""
    location = key.removeprefix("unknown:") if key.startswith("unknown:") else None
    effects = [j for j, m in enumerate(model.members) if key not in (m.candidate.name, m.label)]
    return effects, [g for g, group in enumerate(random) if group.location != location]
