"""Alternatives to the selected effects, pairs that are not identifiable, and effects that these poses cannot observe."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.diagnosis import noise_consistent_ranking
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Alternative, NotSeparable
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import ScoredCandidate
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.effect import Candidate

OBSERVABLE = 2.0  # chi2 that an effect of typical size must make at least, or it would not be observed even several times as large
STRONG = 10.0  # times the typical size
UNDECIDED = 2 * float(np.log(20.0))  # an alternative that is more than a twentieth as probable is not excluded
MOST_ALTERNATIVES = 3  # reported for each effect
MOST_EFFECTS = 6  # of a model whose alternatives are sought


@dataclass(frozen=True)
class Unobservable:
    """An effect that these poses cannot observe at its typical size.

    share: of its squared displacements that the free geometry does not absorb. even_strong: not at STRONG times that size either.
    """

    candidate: Candidate
    share: float
    even_strong: bool


@dataclass(frozen=True)
class SizedEffect:
    """An effect with the value of its hyper-parameter and its coefficients (k,)."""

    candidate: Candidate
    hyper: float | None
    coefficients: np.ndarray

    @property
    def label(self) -> str:
        """``name:where`` as in the JSON object."""
        return f"{self.candidate.name}:{'+'.join(self.candidate.where)}"


@dataclass(frozen=True)
class Alternatives:
    """by_name: alternatives of each selected effect. pairs: each selected effect with one that these data cannot tell from it, with the
    coefficients of either. not_separable: the same pairs as they are reported.
    """

    by_name: dict[str, tuple[Alternative, ...]] = field(default_factory=dict)
    not_separable: tuple[NotSeparable, ...] = ()
    pairs: tuple[tuple[SizedEffect, SizedEffect], ...] = ()


def unobservable(setup: DiagnosisProblem, full: ModelFit) -> list[Unobservable]:
    """The compliance of the joint with the largest range of gravity torque, if these poses cannot observe it."""
    if not setup.context.masses_known:
        return []
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    most_loaded = sorted(elastic, key=lambda c: -np.ptp(setup.context.gravity_torque[:, int(c.where[0][1:]) - 1]))[:1]
    out = []
    for candidate in most_loaded:
        information = 1 / max(full.geometry_only.test(candidate).covariance[0, 0], 1e-300)
        chi2 = candidate.typical[0] ** 2 * information
        if chi2 < OBSERVABLE:
            X = full.geometry_only.block(candidate, None)
            share = float(np.clip(information / np.sum(X * X), 0, 1))
            out.append(Unobservable(candidate, share, bool(STRONG**2 * chi2 < OBSERVABLE)))
    return out


def alternatives(setup: DiagnosisProblem, full: ModelFit) -> Alternatives:
    """For each selected effect: which others, or the same one elsewhere, could stand in its place."""
    model = full.model
    if not model.effects or len(model.effects) > MOST_EFFECTS:
        return Alternatives()
    search = BeamSearch(setup.candidates)
    excess = max(full.geometry_only.chi2 - full.geometry_only.dof, 1e-9)
    by_name: dict[str, tuple[Alternative, ...]] = {}
    not_separable: list[NotSeparable] = []
    pairs: list[tuple[SizedEffect, SizedEffect]] = []
    for name in model.names:
        mine = [j for j, (c, _) in enumerate(model.effects) if c.name == name]
        rest = search.solve(full.geometry_only, tuple(m for j, m in enumerate(model.effects) if j not in mine))
        if rest is None:
            continue
        (first, hyper), lost = model.effects[mine[0]], model.gain - rest.gain
        selected = SizedEffect(first, hyper, model.coefficients[model.slices()[mine[0]]])
        scored = _others(search, full, rest, name, {w for j in mine for w in model.effects[j][0].where})
        if scored:
            by_name[name] = tuple(
                Alternative(s.candidate.name, tuple(s.candidate.where), float(np.clip(s.gain / excess, 0, 1))) for s in scored
            )
        for s in scored:
            swapped = search.solve(full.geometry_only, (*rest.effects, (s.candidate, s.hyper)))
            if swapped is not None and not excluded(setup, full, search, swapped):
                other = SizedEffect(s.candidate, s.hyper, s.coefficients)
                correlation = float(np.clip(s.gain / max(lost, 1e-9), 0, 1))
                not_separable.append(NotSeparable((selected.label, other.label), correlation))
                pairs.append((selected, other))
    return Alternatives(by_name, tuple(not_separable), tuple(pairs))


def _others(search: BeamSearch, full: ModelFit, rest: EffectSet, name: str, where: set[str]) -> list[ScoredCandidate]:
    """The best candidates in place of an effect at these locations, at most one of each name."""
    best: dict[str, ScoredCandidate] = {}
    for scored in search.expand(full.geometry_only, rest):
        candidate = scored.candidate
        itself = candidate.name == name and where.intersection(candidate.where)
        if not itself and candidate.name not in best and len(best) < MOST_ALTERNATIVES:
            best[candidate.name] = scored
    return list(best.values())


def excluded(setup: DiagnosisProblem, full: ModelFit, search: BeamSearch, other: EffectSet) -> bool:
    """Whether another set of effects is less than a twentieth as probable as the selected one, each under the noise that it leaves."""
    if other.log_posterior_odds < full.model.log_posterior_odds - noise_consistent_ranking.MAX_DEFICIT:
        return True
    if full.smooth is not None:  # the noise is that of the unmodelled effects
        return other.log_posterior_odds < full.model.log_posterior_odds - UNDECIDED
    linear = full.geometry_only.linear
    there, solved = noise_consistent_ranking.under_own_noise(search, linear, other, full.noise, setup.prior_noise)
    if solved is None:
        return True
    selected = noise_consistent_ranking.log_posterior(full.geometry_only, full.model, setup.prior_noise)
    return noise_consistent_ranking.log_posterior(there, solved, setup.prior_noise) < selected - UNDECIDED
