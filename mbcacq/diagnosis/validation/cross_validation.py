"""Cross-validation: whole stations (of one station: blocks of poses) are left out of every choice and fit, and predicted.

What happens to a single station alone no other station can know of: whether such a model is good is decided on the other stations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, located_name
from mbcacq.diagnosis.validation.folds import Fold, FoldResult, evaluated_fold, split
from mbcacq.diagnosis.validation.predictive_score import NO_CENTRES, PredictiveScore, held_out_score, predicts_better
from mbcacq.diagnosis.validation.workers import WorkerPool
from mbcacq.effects.pose import payload


@dataclass(frozen=True)
class CrossValidation:
    """Scores on data left out.

    before, after: with geometry alone and with the model. split: how the data were left out. without: the model without one effect, by its
    name, or 'name:location' of one at several; without random effects at a location, by 'unknown:LOCATION'. not_predictive:
    names, and locations of a name, that predict nothing better next to others; they are not in ``after``. decisive: before and after where
    the model may be judged. parametric: of a long recording, whose random effects could explain what parametric ones do, the model without
    these; each effect's gain is then measured against it.
    """

    before: PredictiveScore
    after: PredictiveScore
    split: str
    without: dict[str, PredictiveScore]
    not_predictive: tuple[str, ...] = ()
    decisive: tuple[PredictiveScore, PredictiveScore] = (NO_CENTRES, NO_CENTRES)
    parametric: PredictiveScore | None = None

    def gain(self, key: str) -> float:
        """Share of the held-out excess over the noise floor that an effect removes."""
        whole = self.parametric or self.after
        return self._share(self.without.get(key, whole).chi2 - whole.chi2)

    @property
    def unmodelled_gain(self) -> float:
        """The same of all random effects together."""
        return self._share((self.parametric or self.before).chi2 - self.after.chi2)

    def _share(self, chi2: float) -> float:
        return float(np.clip(chi2 / max(self.before.chi2 - self.before.dof, 1e-9), 0, 1))


def cross_validate(
    problem: DiagnosisProblem,
    full: ModelFit,
    folds: int = 4,
    pool: WorkerPool | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> CrossValidation:
    """The whole search repeated without each fold, its model evaluated on the fold under the noise of the full data.

    pool: of processes that share the folds. progress: gets a sentence a fold.
    """
    linear = full.geometry_only.linear
    fold, how = split(linear, folds)
    left_out = [fold == k for k in range(int(fold.max()) + 1)]
    everywhere = bool(full.random) and not full.cells
    keys = effect_keys(full)
    if not keys and not everywhere:  # nothing is claimed, there is nothing to validate
        plain = geometry_scores(full, left_out)
        return CrossValidation(plain, plain, how, {}, (), (plain, plain))
    expected, elsewhere = bool(full.random), centres_elsewhere(full)
    problem = problem.with_linearization(linear)
    dropped: tuple[str, ...] = ()

    def begun(done: int) -> None:
        if done < len(left_out):
            progress(f"searching again without each part of the data: part {done + 1} of {len(left_out)}")

    begun(0)
    again = [(problem, full.noise, test, expected, keys, elsewhere, everywhere) for test in left_out]
    results: list[FoldResult] = (pool or WorkerPool()).map(evaluated_fold, *zip(*again, strict=True), answered=begun)
    parametric = summed(a.parametric for a in results) if everywhere else None
    before, after, without = totals(results, keys)
    if full.residual_tests is not None and (dropped := not_predictive(full, without, parametric or after)):
        each = zip(left_out, results, strict=True)
        after = summed(Fold(linear, full.noise, test).held_out(a.model.without(dropped), a.random).score() for test, a in each)
    there = summed(a.before_there for a in results), summed(a.after_there for a in results)
    decisive = there if there[0].count > OPTIONS.deciding_share * before.count else (before, after)
    return CrossValidation(before, after, how, without, dropped, decisive, parametric)


def totals(results: list[FoldResult], keys: tuple[str, ...]) -> tuple[PredictiveScore, PredictiveScore, dict[str, PredictiveScore]]:
    """Sums over the folds: before, after, and without each effect."""
    without = {key: summed(a.without[key] for a in results) for key in keys}
    return summed(a.before for a in results), summed(a.after for a in results), without


def effect_keys(full: ModelFit) -> tuple[str, ...]:
    """Keys of what is left out of the model in turn."""
    if full.cells and full.random:
        locations = dict.fromkeys(g.location for g in full.random)
        return (*full.model.names, *full.model.located_names, *(f"unknown:{location}" for location in locations))
    if full.random:
        return full.model.names
    return (*full.model.names, *full.model.located_names)


def geometry_scores(full: ModelFit, left_out: list[np.ndarray]) -> PredictiveScore:
    """Held-out score of geometry alone."""
    linear = full.geometry_only.linear
    pose, keep = linear.obs.pose, linear.keep
    return summed(held_out_score(linear, keep & ~test[pose], keep & test[pose], NO_EFFECTS, (), full.noise) for test in left_out)


def not_predictive(full: ModelFit, without: dict[str, PredictiveScore], whole: PredictiveScore) -> tuple[str, ...]:
    """Names, and locations of a name, without which the left-out data are predicted as well; the best one of several stays."""
    if payload.NAME in full.model.names:
        return ()
    several = full.model.names if len(full.model.names) > 1 else ()
    located = tuple(key for key in full.model.located_names if key in without)
    candidates = (*several, *all_but_the_best(located, without))
    return tuple(key for key in candidates if not acts_on_single_stations(full, key) and not predicts_better(whole, without[key]))


def summed(scores: Iterable[PredictiveScore]) -> PredictiveScore:
    return sum(scores, NO_CENTRES)


def all_but_the_best(located: tuple[str, ...], without: dict[str, PredictiveScore]) -> tuple[str, ...]:
    """The locations of each name, but for the one that predicts most."""
    best: dict[str, str] = {}
    for key in sorted(located, key=lambda s: without[s].chi2):
        best[key.split(":")[0]] = key
    return tuple(s for s in located if s not in best.values())


def acts_on_single_stations(full: ModelFit, key: str) -> bool:
    """Whether an effect ('name' or 'name:location') happens to single stations alone."""
    return all(w.startswith("station") for c, _ in full.model.effects if key in (c.name, located_name(c)) for w in c.where)


def centres_elsewhere(full: ModelFit) -> np.ndarray:
    """(M,) bool of the centres at stations to which nothing of the model happens alone."""
    obs = full.geometry_only.linear.obs
    alone = {w for c, _ in full.model.effects if acts_on_single_stations(full, c.name) for w in c.where}
    return ~np.isin(obs.station, [j for j, s in enumerate(obs.cell.stations) if f"station{s.id}" in alone])[obs.pose]
