"""One pass from observations to a model: named effects compete, what is left is examined, what has no name is modelled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis import noise_consistent_ranking
from mbcacq.diagnosis.linearized import variance_components
from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric import model_comparison, random_effects
from mbcacq.diagnosis.nonparametric import residual_tests as remains
from mbcacq.diagnosis.nonparametric.evidence_atlas import EvidenceMap, MapCell
from mbcacq.diagnosis.nonparametric.joint_model import columns_of, outliers, settle, with_members
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.problem import DiagnosisProblem, back, prepare, thin
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NOTHING, EffectSet
from mbcacq.diagnosis.search.pruning import pruned

__all__ = ["ModelFit", "DiagnosisProblem", "find", "prepare", "search_named"]

PASSES = 4
ALLOWANCE = 10.0  # chi2 that a name may lack where one is known to be
SEARCHED = 800  # poses that the search for names looks at, of a long recording


@dataclass(frozen=True)
class ModelFit:
    """model: named effects; smooth: what has no name, or None; cells: where the map put its groups. noise: estimated with both in place.

    before, named: screens (geometry only; named effects too) under that noise. leftover: examination of what named effects leave.
    """

    model: EffectSet
    smooth: RandomEffectsModel | None
    cells: tuple[MapCell, ...]
    noise: NoiseEstimate
    before: CandidateScoring
    named: CandidateScoring
    leftover: ResidualTests | None


def search_named(
    setup: DiagnosisProblem, linear: LinearProblem, settling: bool = True, start: NoiseEstimate | None = None, allowance: float = 0.0
) -> tuple[EffectSet, NoiseEstimate, BeamSearch, LinearProblem]:
    """Named effects, noise and linearisation in turns, until the set of effects stands still."""
    large = linear.obs.n_poses > variance_components.MANY_POSES
    search = BeamSearch(
        setup.candidates,
        beam=1 if large else 3,
        branches=3 if large else 6,
        most=5 if large else 10,
        thorough=not large,
        least_share=0.003 if large else 0.0,
        situation=None if large else setup.situation,
        allowance=allowance,
    )
    sigma = start or variance_components.estimate(linear, *columns_of(linear, NOTHING, None), setup.first, setup.first)
    model = NOTHING
    for turn in range(2 if large or not settling else PASSES):
        screen = CandidateScoring(linear, sigma)
        start = NOTHING
        if large:  # every arm is elastic: what elasticity explains is not given to slow periodic errors
            elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
            start = BeamSearch(elastic, beam=1, branches=2, most=6).run(screen) if turn == 0 else model
            if turn == 0:
                search = replace(search, protected=frozenset(c.key for c, _ in start.members))
        new = search.grow(screen, start)
        if turn == 0 and not large and len(new.members) > 1 and model_comparison.overshadowed(screen, setup.chart, new):
            return NOTHING, sigma, search, linear
        new = search.settled(screen, new)
        if turn == 0 and not large and not new.members:
            new = noise_consistent_ranking.second_look(search, linear, sigma, setup.first)
        same = {c.key for c, _ in new.members} == {c.key for c, _ in model.members}
        model = new
        if not model.members:
            break
        sigma = variance_components.estimate(linear, *columns_of(linear, model, None), sigma, setup.first)
        for _ in range(2 * settling):
            linear = settle(linear, model, sigma)
        if same:
            break
    if model.members and not large:
        model, sigma = noise_consistent_ranking.contested(search, linear, model, sigma, setup.first)
    return model, sigma, search, linear


def find(
    setup: DiagnosisProblem, keep: np.ndarray | None = None, again: bool = True, expected: bool = False, name_expected: bool = False
) -> ModelFit:
    """The model of the centres in keep; without keep, outliers are reconsidered once with the model in place.

    expected: structure is known to be there, so less evidence suffices; name_expected: a name is, and the most probable is taken.
    """
    linear = setup.linear if keep is None else setup.linear.restricted(keep)
    if linear.obs.n_poses > variance_components.MANY_POSES:
        return find_in_many(setup, linear, keep, again, expected)
    plain, sigma, search, settled, model = named_in_turns(setup, linear, keep, ALLOWANCE if name_expected else 0.0)
    before = CandidateScoring(settled, sigma)
    model = pruned(search, before, search.solve(before, model.members, permit=True))
    if keep is None and again:
        better = outliers(before, model)
        if not np.array_equal(better, settled.keep) and np.mean(~better) < 0.05:
            return find(replace(setup, linear=settled.restricted(better)), None, again=False)
    atlas, named = EvidenceMap(before, setup.chart), with_members(before, model)
    left = remains.examine(named, setup.situation, atlas)
    least = 0.0 if expected else remains.STRUCTURE
    doubtful = model.members and 2 * atlas.judge(before).best().weighed > model.worth
    if left.judged.total < least and not left.structure and not doubtful:
        return ModelFit(model, None, (), sigma, before, named, left)
    ground = model_comparison.ComparisonProblem(settled, setup.chart, setup.first, search, least)
    best = model_comparison.contest(ground, model, sigma, plain)
    before = CandidateScoring(settled, best.noise)
    model = told_of(search, before, best.model, best.smooth)
    return ModelFit(model, best.smooth, best.cells, best.noise, before, with_members(before, model), left)


def told_of(search: BeamSearch, screen: CandidateScoring, model: EffectSet, rest: RandomEffectsModel | None) -> EffectSet:
    """Those names that are still significant beside what has no name, with their coefficients without it as before."""
    if not model.members or rest is None:
        return pruned(search, screen, model)
    kept = pruned(search, CandidateScoring(screen.linear, screen.noise, (rest.columns, rest.sigma)), model)
    return search.solve(screen, kept.members, permit=True)


def named_in_turns(setup: DiagnosisProblem, linear: LinearProblem, keep: np.ndarray | None, allowance: float):
    plain = variance_components.estimate(linear, *columns_of(linear, NOTHING, None), setup.first, setup.first)
    model, sigma, search, settled = search_named(setup, linear, settling=keep is None, start=plain, allowance=allowance)
    return plain, sigma, search, settled, model


def find_in_many(setup: DiagnosisProblem, linear: LinearProblem, keep: np.ndarray | None, again: bool, expected: bool) -> ModelFit:
    """The same for a long recording: names are sought in a part of it, the rest is smooth groups at every place."""
    small = thin(setup, linear.keep, SEARCHED)
    model, sigma, search, _ = search_named(small, small.linear, settling=keep is None)
    model = back(setup, small, model)
    linear = settle(linear, model, sigma)
    sigma = variance_components.estimate(linear, *columns_of(linear, model, None), sigma, setup.first)
    search = BeamSearch(setup.candidates, thorough=False, protected=search.protected)
    before = CandidateScoring(linear, sigma)
    model = pruned(search, before, model)
    if keep is None and again:
        better = outliers(before, model)
        if not np.array_equal(better, linear.keep) and np.mean(~better) < 0.05:
            return find(replace(setup, linear=linear.restricted(better)), None, again=False)
    named, left, rest = with_members(before, model), None, None
    if keep is None:
        screen = CandidateScoring(small.linear, sigma)
        left = remains.examine(with_members(screen, back(small, setup, model)), small.situation, EvidenceMap(screen, small.chart))
    if expected or (left is not None and left.structure):
        groups, sizes = random_effects.everything(linear, setup.situation), None
        for _ in range(2):
            new = random_effects.fit(named, groups, sizes)
            if new is None:
                break
            rest, groups, sizes = new, new.groups, new.sizes
            sigma = noise_beside(linear, model, rest, sigma, setup.first)
            before = CandidateScoring(linear, sigma)
            named = with_members(before, model)
    # The groups could explain what names do, with many more coefficients: here names are not tested beside them, but on data left out.
    model = search.solve(before, model.members, permit=True)
    named = with_members(before, model)
    if rest is not None:
        rest = random_effects.fit(named, groups, sizes) or rest
    return ModelFit(model, rest, (), sigma, before, named, left)


def noise_beside(
    linear: LinearProblem, model: EffectSet, rest: RandomEffectsModel, start: NoiseEstimate, prior: NoiseEstimate
) -> NoiseEstimate:
    """Noise of what smooth groups leave, counting the coefficients they used."""
    less = linear.restricted(linear.keep)
    less.residual = linear.residual - rest.columns @ rest.coefficients
    sigma = variance_components.estimate(less, *columns_of(less, model, None), start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - rest.used, 0.3 * rows))
    return NoiseEstimate(sigma.point * grow, sigma.joint * grow, sigma.turn * grow)
