"""Proof on data that took no part: whole stations (for one station: blocks of poses) are left out of every choice and fit.

What happens to a single station alone no other station can know of: whether such a model is good is judged on the stations elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import NOTHING, spot
from mbcacq.diagnosis.validation.folds import Fold, split
from mbcacq.diagnosis.validation.predictive_score import EMPTY, PredictiveScore, better, judge
from mbcacq.diagnosis.validation.workers import WorkerPool
from mbcacq.effects.pose import payload

MOST = 0.8  # share of the centres that must be elsewhere for them to decide


@dataclass(frozen=True)
class CrossValidation:
    """before and after on left-out data, how they were left out. without: the same with one effect left out of the model, by its name, or
    'name:place' of one at several; of what has no name by 'unknown:PLACE'. picks: names that each fold found. empty: names, and places of a
    name, beside others that predict nothing better; they are not in ``after``. decides: before and after where the model may be judged, see
    above. named: of a long recording, whose groups could do what names do: with the names alone, to which each name is held.
    """

    before: PredictiveScore
    after: PredictiveScore
    split: str
    without: dict[str, PredictiveScore]
    picks: tuple[tuple[str, ...], ...]
    empty: tuple[str, ...] = ()
    decides: tuple[PredictiveScore, PredictiveScore] = (EMPTY, EMPTY)
    named: PredictiveScore | None = None

    def gain(self, key: str) -> float:
        """Share of the held-out excess over the noise floor that an effect removes."""
        excess = max(self.before.chi2 - self.before.dof, 1e-9)
        whole = self.named or self.after
        return float(np.clip((self.without.get(key, whole).chi2 - whole.chi2) / excess, 0, 1))

    @property
    def nameless(self) -> float:
        """The same of all that has no name."""
        excess = max(self.before.chi2 - self.before.dof, 1e-9)
        return float(np.clip(((self.named or self.before).chi2 - self.after.chi2) / excess, 0, 1))


def prove(setup: DiagnosisProblem, full: ModelFit, folds: int = 4, workers: int = 1) -> CrossValidation:
    """The whole search repeated without each fold, its model tried on the fold; weights are those of the full data."""
    linear = full.before.linear
    fold, how = split(linear, folds)
    left_out = [fold == k for k in range(int(fold.max()) + 1)]
    everywhere = full.smooth is not None and not full.cells
    nameless = dict.fromkeys(g.at for g in full.smooth.groups) if full.cells else ()
    spots = () if everywhere else full.model.spots
    keys = (*full.model.names, *spots, *(f"unknown:{at}" for at in nameless))
    if not keys and not everywhere:  # nothing is claimed, there is nothing to prove
        plain = total(
            judge(linear, linear.keep & ~test[linear.obs.pose], linear.keep & test[linear.obs.pose], NOTHING, None, full.noise)
            for test in left_out
        )
        return CrossValidation(plain, plain, how, {}, (), (), (plain, plain))
    with WorkerPool(lambda k: Fold(setup, full, left_out[k], full.smooth is not None), len(left_out), workers) as crew:
        answers = crew.ask("answer", keys, away_from(full), everywhere)
        before, after = total(a.before for a in answers), total(a.after for a in answers)
        without = {key: total(a.without[key] for a in answers) for key in keys}
        named = total(a.named for a in answers) if everywhere else None
        empty = ()
        if payload.NAME not in full.model.names:
            beside = (*(full.model.names if len(full.model.names) > 1 else ()), *all_but_the_best(spots, without))
            empty = tuple(key for key in beside if not stays(full, key) and not better(named or after, without[key]))
        if empty:
            after = total(crew.ask("without", empty))
    there = total(a.before_there for a in answers), total(a.after_there for a in answers)
    decides = there if there[0].count > MOST * before.count else (before, after)
    return CrossValidation(before, after, how, without, tuple(a.picks for a in answers), empty, decides, named)


def total(qualities: Iterable[PredictiveScore]) -> PredictiveScore:
    return sum(qualities, EMPTY)


def all_but_the_best(spots: tuple[str, ...], without: dict[str, PredictiveScore]) -> tuple[str, ...]:
    """The places of each name, but for the one that predicts most."""
    best: dict[str, str] = {}
    for at in sorted(spots, key=lambda s: without[s].chi2):
        best[at.split(":")[0]] = at
    return tuple(s for s in spots if s not in best.values())


def stays(full: ModelFit, key: str) -> bool:
    """Whether an effect ('name' or 'name:place') happens to single stations alone."""
    return all(w.startswith("station") for c, _ in full.model.members if key in (c.name, spot(c)) for w in c.where)


def away_from(full: ModelFit) -> np.ndarray:
    """(M,) bool of the centres at stations to which nothing of the model happens alone."""
    obs = full.before.linear.obs
    alone = {w for c, _ in full.model.members if stays(full, c.name) for w in c.where}
    return ~np.isin(obs.station, [j for j, s in enumerate(obs.cell.stations) if f"station{s.id}" in alone])[obs.pose]
