"""Folds: how a recording is split, the whole search repeated without each, and the models so found evaluated on what they have not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.executor import WorkerPool
from mbcacq.diagnosis.model_fit import ModelFit, PartModel, fit_part, groups_everywhere
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.diagnosis.validation.predictive_score import NO_CENTRES, PredictiveScore, SharedProducts
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.model.observations import Observations


@dataclass(frozen=True, kw_only=True)
class RepeatedSearch:
    """The search without each part of the poses, begun in other processes. problem: linearised at the fit of all data; left_out: (P,) bool
    of each part, of one or several kinds (``how``). models: returns what was found without each, when all of it is there, at every call;
    it gets a function that is called with how many there are.
    """

    problem: DiagnosisProblem
    left_out: list[np.ndarray]
    how: str
    models: Callable[[Callable[[int], None]], list[PartModel]]

    @classmethod
    def begin(cls, problem: DiagnosisProblem, folds: int | None, pool: WorkerPool, unmodelled: bool) -> RepeatedSearch:
        """folds: None for as many as a recording of so many poses usually has. unmodelled: of a long recording, whether there may be
        anything but effects of the catalogue.
        """
        usual = OPTIONS.folds if problem.linear.obs.n_poses < 2 * OPTIONS.searched_poses else 2
        return cls._begun(problem, *split(problem.linear, folds or usual), pool, unmodelled)

    @classmethod
    def halves(cls, problem: DiagnosisProblem, pool: WorkerPool) -> RepeatedSearch:
        """The search of each of two halves, made of blocks of the order of measurement. No block is in both halves."""
        return cls._begun(problem, blocks(problem.linear.obs, 2), "block", pool, True)

    @classmethod
    def _begun(cls, problem: DiagnosisProblem, fold: np.ndarray, how: str, pool: WorkerPool, unmodelled: bool) -> RepeatedSearch:
        left_out = [fold == k for k in range(int(fold.max()) + 1)]
        calls = zip(*((problem, test, unmodelled) for test in left_out), strict=True)
        answers, kept = pool.begin(model_without, *calls, elsewhere=problem.in_part), list[PartModel]()

        def models(answered: Callable[[int], None] = lambda count: None) -> list[PartModel]:
            if not kept:
                kept.extend(answers(answered))
            return kept

        return cls(problem=problem, left_out=left_out, how=how, models=models)

    @property
    def of_halves(self) -> bool:
        """Whether its parts share no pose: each is searched without the other half."""
        return self.how == "block" and len(self.left_out) == 2


def repeated_early(problem: DiagnosisProblem, folds: int | None, pool: WorkerPool) -> tuple[RepeatedSearch, RepeatedSearch] | None:
    """The search without each part of a long recording, and of its halves, begun before that of all of it, on which they do not depend;
    None for a short recording. folds: as ``RepeatedSearch.begin``.
    """
    if not problem.in_part:
        return None
    again = RepeatedSearch.begin(problem, folds, pool, True)
    return again, again if again.of_halves else RepeatedSearch.halves(problem, pool)


def repeated(problem: DiagnosisProblem, full: ModelFit, folds: int | None, pool: WorkerPool) -> tuple[RepeatedSearch, RepeatedSearch]:
    """The same of a recording at the linearisation of the fit of all of it, which was found before; its parts stand for halves."""
    pool = WorkerPool() if full.empty else pool  # nothing is claimed, there is nothing to validate
    again = RepeatedSearch.begin(problem.with_linearization(full.geometry_only.linear), folds, pool, bool(full.random))
    return again, again


def model_without(problem: DiagnosisProblem, test: np.ndarray, unmodelled: bool) -> PartModel:
    """The model found without a part, test (P,) bool, of the poses; groups at all locations of a long recording without their parts, which
    are large and the same for all. unmodelled: of a long recording, whether there is anything but effects of the catalogue.
    """
    linear = problem.linear
    found = fit_part(problem, linear.keep & ~test[linear.obs.pose], unmodelled)
    return replace(found, random=tuple(replace(g, parts=()) for g in found.random)) if problem.in_part else found


@dataclass(frozen=True)
class FoldResult:
    """before, after: score on the fold with geometry alone and with the model found without it. without: the same without one effect, by
    its key. parametric: without random effects. missed: keys of effects that were not found without the fold.
    """

    before: PredictiveScore
    after: PredictiveScore
    without: dict[str, PredictiveScore]
    parametric: PredictiveScore
    missed: frozenset[str]


Refitted = dict[str, tuple[PredictiveScore, PredictiveScore]]


def evaluated_folds(
    full: ModelFit, again: RepeatedSearch, keys: Sequence[str], searched: Callable[[int], None]
) -> tuple[list[FoldResult], Refitted]:
    """The models found without each part, evaluated on that part under the noise of the fit of all data.

    keys: effects to be left out in turn. searched: gets how many of the searches have ended. Effects that most of the searches did not find
    have scores with and without them as well, of the model of all data with its coefficients fitted without the part.
    """
    problem, models = again.problem, [(found.model, found.random) for found in again.models(searched)]
    if problem.in_part:
        groups = {(g.location, g.depends_on): g for g in groups_everywhere(problem)} if full.random else {}
        alive = ((model, [g for g in random if groups]) for model, random in models)
        models = [(model, tuple(replace(groups[g.location, g.depends_on], sigma=g.sigma) for g in random)) for model, random in alive]
    products = SharedProducts(full.joint, models, again.left_out)
    results = [evaluated_fold(full, model, random, keys, products, number) for number, (model, random) in enumerate(models)]
    missed = [key for key in keys if 2 * sum(key in one.missed for one in results) > len(results)]
    nothing: Refitted = dict.fromkeys(missed, (NO_CENTRES, NO_CENTRES))
    for number in range(len(models)) if missed else ():
        random = () if full.everywhere else full.random
        held = products.held_out(number, full.model, random, full.noise)
        whole = held.score()
        for key, (with_it, without) in nothing.items():
            nothing[key] = with_it + whole, without + held.score(*all_but(full.model, random, key, keys))
    return results, nothing


def evaluated_fold(
    full: ModelFit, model: EffectSet, random: tuple[RandomEffect, ...], keys: Sequence[str], products: SharedProducts, number: int
) -> FoldResult:
    """The scores of the model found without a part, of this number, on that part."""
    held = products.held_out(number, model, random, full.noise)
    everywhere = full.everywhere
    after = held.score()
    whole = held.score(groups=()) if everywhere else after
    without, missed = {}, set[str]()
    for key in keys:
        effects, groups = all_but(model, () if everywhere else random, key, keys)
        same = len(effects) == len(model.members) and (everywhere or len(groups) == len(random))
        missed |= {key} if same else set()
        without[key] = whole if same else held.score(effects, groups)
    return FoldResult(held.score((), ()), after, without, whole, frozenset(missed))


def split(linear: LinearProblem, folds: int) -> tuple[np.ndarray, str]:
    """(P,) fold of each pose, and what was left out. Stations go whole, also where there are two. Each recording is cut into blocks of its
    order of measurement if there is one station, or if nothing would be left of one of several recordings.
    """
    obs = linear.obs
    stations = np.unique(obs.station)
    recording = np.zeros(obs.n_poses, int) if obs.recording is None else obs.recording
    size = np.bincount(obs.station, minlength=len(obs.cell.stations))
    kind = np.array([[a.id for a in obs.cell.artefacts].index(s.artefact) for s in obs.cell.stations])
    ranked = sorted(stations, key=lambda k: (kind[k], -size[k], k))
    of_station = np.zeros(len(obs.cell.stations), int)
    of_station[ranked] = np.arange(len(ranked)) % min(folds, len(ranked))
    fold = of_station[obs.station]
    if all(len(np.unique(fold[recording == r])) >= 2 for r in np.unique(recording)):
        return fold, "station"
    return blocks(obs, folds), "block"


def blocks(obs: Observations, folds: int) -> np.ndarray:
    """(P,) fold of each pose: four blocks of the order of measurement in each fold, of each of several recordings."""
    recording = np.zeros(obs.n_poses, int) if obs.recording is None else obs.recording
    measured = np.argsort(obs.measuring_order)
    out = np.zeros(obs.n_poses, int)
    for r in np.unique(recording):
        here = recording == r
        out[here] = np.argsort(np.argsort(measured[here])) * (4 * folds) // here.sum()
    return out % folds


def all_but(model: EffectSet, random: Sequence[RandomEffect], key: str, keys: Sequence[str] = ()) -> tuple[list[int], list[int]]:
    """Numbers of the effects and groups of a fold's model without one effect.

    keys: of all that is reported. Without something unmodelled at a location, what a fold has found there under a name that is not
    reported is left out as well: it is the same error.
    """
    location = key.removeprefix("unknown:") if key.startswith("unknown:") else None

    def stands_for_it(m: Member) -> bool:
        return key in (m.candidate.name, m.label) or (location in m.candidate.where and not {m.candidate.name, m.label} & set(keys))

    effects = [j for j, m in enumerate(model.members) if not stands_for_it(m)]
    return effects, [g for g, group in enumerate(random) if group.location != location]
