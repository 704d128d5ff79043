"""What could be achieved: the true effect alone, with its location and its order or moment known, fitted as the diagnosis fits."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidate, evidence_of_one
from mbcacq.diagnosis.evidence.evidence_fit import kept_centres
from mbcacq.diagnosis.evidence.hypothesis import under
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.nonparametric.joint_model import noise_with
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.diagnosis.validation import folds, predictive_score
from mbcacq.effects.catalogue import declaration
from mbcacq.effects.declaration import EffectCoupling, Where
from mbcacq.effects.effect import MOMENT, Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import pack
from mbcacq.model.observations import Observations

FOLDS = 4


@dataclass(frozen=True)
class Achievable:
    """Held-out chi2 per degree of freedom without and with the true model. known: whether the catalogue had it for these data.
    less: of several effects, with the true model but one, in their order.
    """

    before: float
    after: float
    known: bool
    less: tuple[float, ...] = ()

    @property
    def improvement(self) -> float:
        """Share of the held-out chi2 that goes away."""
        return 1.0 - self.after / self.before if self.before > 0 else 0.0

    @property
    def adds(self) -> tuple[float, ...]:
        """Share of the held-out chi2 that each of several effects takes away in addition to the others."""
        return tuple(1.0 - self.after / without for without in self.less)


def achievable(observations: Observations, truth: list[dict[str, Any]]) -> Achievable:
    """truth: the injected effects, as the fake cell states them after the recording."""
    setup = prepare(observations)
    each = [true_members(setup, effect) for effect in truth]
    companions = [m for effect in truth for m in elastic(setup, effect)]
    known = bool(truth) and all(each)
    model, rest = EffectSet((*companions, *chain.from_iterable(each))), EffectSet(tuple(companions))
    linear = setup.linear
    sigma = noise_with(linear, model, setup.noise, setup.prior_noise)
    better = kept_centres(under(NoisePoint(linear, setup.prior_noise, pack(sigma)), model.members, 0.0))
    if np.mean(~better) < 0.05:
        linear = linear.restricted(better)
        sigma = noise_with(linear, model, sigma, setup.prior_noise)
    at_station = any(w.startswith("station") for effect in truth for w in effect["where"])
    others = [EffectSet((*companions, *chain.from_iterable(each[:j] + each[j + 1 :]))) for j in range(len(each))] if len(each) > 1 else []
    before, after, *less = (held_out(linear, m, sigma, at_station) for m in (rest, model, *others))
    return Achievable(before, after, known, tuple(less))


def true_members(setup: DiagnosisProblem, effect: dict[str, Any]) -> list[Member]:
    """The catalogue's candidates that are the injected effect; only the best-fitting one of several variants, for its size."""
    if (coupling := declaration(effect["name"]).coupling) is not None:
        return [Member(c, None) for c in coupling.candidates(setup.context, carriers(coupling, effect))]
    chosen = []
    screen = CandidateScoring.of(setup.linear, setup.noise)
    for group in location_sets(effect):
        fitting = [c for c in setup.candidates if c.name == effect["name"] and set(c.where) == group]
        each = [(c, hyper) for c in fitting for hyper in true_hypers(setup, c, effect)]
        scored = [evidence_of_candidate(screen, c) if hyper is None else evidence_of_one(screen, c, hyper) for c, hyper in each]
        if any(c.periodic for c in fitting):
            chosen += [m for _, m in scored]
        elif scored:
            chosen.append(max(scored, key=lambda one: one[0])[1])
    return chosen


def carriers(coupling: EffectCoupling, effect: dict[str, Any]) -> dict[Where, float]:
    """Location -> true coefficient of the effect through which alone an injected one shows."""
    return {(f"A{i + 1}",): float(c) for i, c in enumerate(effect[coupling.parameter]) if c > 0}


def elastic(setup: DiagnosisProblem, effect: dict[str, Any]) -> list[Member]:
    """Effects through which alone an injected one shows (a wrong payload through elastic joints): they are no part of its own gain."""
    coupling = declaration(effect["name"]).coupling
    if coupling is None:
        return []
    where = carriers(coupling, effect)
    return [Member(c, None) for c in setup.candidates if c.name == coupling.through and c.where in where]


def location_sets(effect: dict[str, Any]) -> list[set[str]]:
    """Locations of the candidates: several joints of one effect are one candidate each, a coupling is one of two joints."""
    where = effect["where"]
    return [set(where)] if declaration(effect["name"]).between_locations else [{w} for w in where]


def true_hypers(setup: DiagnosisProblem, candidate: Candidate, effect: dict[str, Any]) -> list[float | None]:
    if candidate.hyper is None:
        return [None]
    value = effect.get(candidate.hyper.name)
    if value is None:
        return [None]
    if candidate.hyper.kind == MOMENT:
        here = np.flatnonzero(setup.linear.obs.pose_id == int(value))
        return [float(setup.context.order[here[0]])] if len(here) else [None]
    return [float(v) for v in np.atleast_1d(value)]


def without_effect(with_it: Observations, without_it: Observations) -> Achievable:
    """For an effect outside the catalogue: held-out chi2 of the geometry alone, and in the same cell had nothing been injected."""
    clean = prepare(without_it)
    sigma = noise_with(clean.linear, NO_EFFECTS, clean.noise, clean.prior_noise)
    return Achievable(held_out(prepare(with_it).linear, NO_EFFECTS, sigma), held_out(clean.linear, NO_EFFECTS, sigma), False)


def held_out(linear: LinearProblem, model: EffectSet, sigma: Noise, by_pose: bool = False) -> float:
    """chi2 per degree of freedom on stations left out in turn. by_pose: on poses, for what happens to one station alone."""
    fold = np.arange(linear.obs.n_poses) % FOLDS if by_pose else folds.split(linear, FOLDS)[0]
    total = predictive_score.NO_CENTRES
    for k in range(int(fold.max()) + 1):
        train, test = linear.keep & (fold != k)[linear.obs.pose], linear.keep & (fold == k)[linear.obs.pose]
        total += predictive_score.HeldOutPrediction(linear, train, test, model, (), sigma).score()
    return total.chi2_dof
