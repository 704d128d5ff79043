"""One pass from observations to a model: parametric effects are searched, the residual is tested, what they leave is modelled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis import noise_consistent_ranking
from mbcacq.diagnosis.nonparametric import model_comparison, random_effects, residual_tests
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapCell
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, kept_centres, noise_with, relinearized
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare, thinned, transferred
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.diagnosis.search.pruning import pruned
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "prepare", "search_parametric_effects"]


@dataclass(frozen=True)
class ModelFit:
    """What one pass has found.

    model: parametric effects. smooth: random effects, or None. cells: where the evidence map put them; empty where they stand at all
    locations. noise: estimated with both in place. geometry_only, conditioned: the projected problem under that noise, with geometry alone
    and conditioned on the parametric effects. residual_tests: of what parametric effects leave.
    """

    model: EffectSet
    smooth: RandomEffectsModel | None
    cells: tuple[MapCell, ...]
    noise: Noise
    geometry_only: CandidateScoring
    conditioned: CandidateScoring
    residual_tests: ResidualTests | None


@dataclass(frozen=True)
class SearchResult:
    """Parametric effects, the noise with them in place, the search that found them, the linearisation with them in place."""

    model: EffectSet
    noise: Noise
    search: BeamSearch
    linear: LinearProblem


def search_parametric_effects(
    problem: DiagnosisProblem, linear: LinearProblem, plain: Noise, relinearize: bool = True, threshold_reduction: float = 0.0
) -> SearchResult:
    """Parametric effects, noise and linearisation in turns, until the set of effects stands still. plain: noise with geometry alone."""
    large = linear.obs.n_poses > OPTIONS.many_poses
    search, noise, model = beam_search_for(problem, large, threshold_reduction), plain, NO_EFFECTS
    for number in range(2 if large or not relinearize else OPTIONS.most_passes):
        projected = CandidateScoring.of(linear, noise)
        start = NO_EFFECTS
        if large and number == 0:
            start = elastic_joints(problem, projected)
            search = replace(search, protected=frozenset(c.key for c, _ in start.effects))
        elif large:
            start = model
        new = search.beam_search(projected, start)
        first = number == 0 and not large
        if first and len(new.effects) > 1 and model_comparison.single_block_more_probable(projected, problem.design_blocks, new):
            return SearchResult(NO_EFFECTS, noise, search, linear)
        new = search.polished(projected, new)
        if first and not new.effects:
            new = noise_consistent_ranking.reconsider_near_misses(search, linear, noise, problem.prior_noise)
        same = {c.key for c, _ in new.effects} == {c.key for c, _ in model.effects}
        model = new
        if not model.effects:
            break
        noise = noise_with(linear, model, None, noise, problem.prior_noise)
        for _ in range(2 * relinearize):
            linear = relinearized(linear, model, noise)
        if same:
            break
    if model.effects and not large:
        model, noise = noise_consistent_ranking.compare_single_exchanges(search, linear, model, noise, problem.prior_noise)
    return SearchResult(model, noise, search, linear)


def beam_search_for(problem: DiagnosisProblem, large: bool, threshold_reduction: float) -> BeamSearch:
    """The search for a recording; a long one is searched with a narrow beam."""
    if large:
        return BeamSearch(
            problem.candidates,
            beam_width=1,
            branches=3,
            rounds=5,
            thorough=False,
            least_share=0.003,
            threshold_reduction=threshold_reduction,
        )
    return BeamSearch(problem.candidates, rounds=10, context=problem.context, threshold_reduction=threshold_reduction)


def elastic_joints(problem: DiagnosisProblem, projected: CandidateScoring) -> EffectSet:
    """Every arm is elastic: what elasticity explains is not given to slow periodic errors."""
    elastic = [c for c in problem.candidates if c.name == "joint_compliance"]
    return BeamSearch(elastic, beam_width=1, branches=2, rounds=6).run(projected)


def fit_model(
    problem: DiagnosisProblem,
    keep: np.ndarray | None = None,
    reconsider: bool = True,
    structure_expected: bool = False,
    effect_expected: bool = False,
) -> ModelFit:
    """The model of the centres in keep (M,); without keep, outliers are reconsidered once with the model in place.

    structure_expected: structure is known to be there, so less evidence suffices; effect_expected: a parametric effect is, and the most
    probable is taken.
    """
    linear = problem.linear if keep is None else problem.linear.restricted(keep)
    if linear.obs.n_poses > OPTIONS.many_poses:
        return fit_long_recording(problem, linear, keep, reconsider, structure_expected)
    settled = linear is problem.linear and reconsider  # the adjustment's own noise is of these centres
    plain = problem.noise if settled else noise_with(linear, NO_EFFECTS, None, problem.noise, problem.prior_noise)
    reduction = OPTIONS.known_effect_reduction if effect_expected else 0.0
    found = search_parametric_effects(problem, linear, plain, keep is None, reduction)
    search, noise = found.search, found.noise
    projected = CandidateScoring.of(found.linear, noise)
    model = pruned(search, projected, search.solved(projected, found.model.effects))
    if keep is None and reconsider:
        better = reconsidered_outliers(projected, model)
        if better is not None:
            return fit_model(problem.with_linearization(better), None, reconsider=False)
    evidence_map, conditioned = EvidenceMap(projected, problem.design_blocks), conditioned_on_effects(projected, model)
    tests = residual_tests.examine_residual(conditioned, problem.context, evidence_map)
    least = 0.0 if structure_expected else residual_tests.STRUCTURE
    doubtful = model.effects and 2 * evidence_map.evaluate(projected).best().log_posterior > model.log_posterior_odds
    if tests.evidence.total < least and not tests.structure and not doubtful:
        return ModelFit(model, None, (), noise, projected, conditioned, tests)
    comparison = model_comparison.ComparisonProblem(found.linear, problem.design_blocks, problem.prior_noise, search, least)
    best = model_comparison.most_probable_hypothesis(comparison, model, noise, plain)
    projected = CandidateScoring.of(found.linear, best.noise)
    model = reported_effects(search, projected, best.model, best.smooth)
    return ModelFit(model, best.smooth, best.cells, best.noise, projected, conditioned_on_effects(projected, model), tests)


def reconsidered_outliers(projected: CandidateScoring, model: EffectSet) -> LinearProblem | None:
    """The linearisation with the outliers judged with the model in place; None where they are the same, or too many to be outliers."""
    keep = kept_centres(projected, model)
    if np.array_equal(keep, projected.linear.keep) or np.mean(~keep) >= OPTIONS.most_outliers:
        return None
    return projected.linear.restricted(keep)


def reported_effects(search: BeamSearch, projected: CandidateScoring, model: EffectSet, smooth: RandomEffectsModel | None) -> EffectSet:
    """Those parametric effects that are still significant with random effects projected out, with their coefficients without these."""
    if not model.effects or smooth is None:
        return pruned(search, projected, model)
    kept = pruned(search, CandidateScoring.of(projected.linear, projected.noise, (smooth.columns, smooth.sigma)), model)
    return search.solved(projected, kept.effects)


def fit_long_recording(
    problem: DiagnosisProblem, linear: LinearProblem, keep: np.ndarray | None, reconsider: bool, structure_expected: bool
) -> ModelFit:
    """The same for a long recording: effects are searched in a part of it, the remainder is random effects at every location."""
    small = thinned(problem, linear.keep, OPTIONS.searched_poses)
    plain = noise_with(small.linear, NO_EFFECTS, None, small.noise, small.prior_noise)
    found = search_parametric_effects(small, small.linear, plain, keep is None)
    model = transferred(small, problem, found.model)
    linear = relinearized(linear, model, found.noise)
    noise = noise_with(linear, model, None, found.noise, problem.prior_noise)
    search = BeamSearch(problem.candidates, thorough=False, protected=found.search.protected)
    projected = CandidateScoring.of(linear, noise)
    model = pruned(search, projected, model)
    if keep is None and reconsider:
        better = reconsidered_outliers(projected, model)
        if better is not None:
            return fit_model(problem.with_linearization(better), None, reconsider=False)
    tests = examine_thinned(problem, small, model, noise) if keep is None else None
    smooth = None
    if structure_expected or (tests is not None and tests.structure):
        smooth, projected = random_effects_everywhere(problem, projected, model)
    # Random effects could explain what parametric effects do, with many more coefficients: here effects are not tested with them in place,
    # but on data left out.
    model = search.solved(projected, model.effects)
    conditioned = conditioned_on_effects(projected, model)
    if smooth is not None:
        smooth = random_effects.fit_random_effects(conditioned, smooth.groups, smooth.sizes) or smooth
    return ModelFit(model, smooth, (), projected.noise, projected, conditioned, tests)


def examine_thinned(problem: DiagnosisProblem, small: DiagnosisProblem, model: EffectSet, noise: Noise) -> ResidualTests:
    """Residual tests of a thinned recording with the effects found on the whole of it."""
    projected = CandidateScoring.of(small.linear, noise)
    conditioned = conditioned_on_effects(projected, transferred(problem, small, model))
    return residual_tests.examine_residual(conditioned, small.context, EvidenceMap(projected, small.design_blocks))


def random_effects_everywhere(
    problem: DiagnosisProblem, projected: CandidateScoring, model: EffectSet
) -> tuple[RandomEffectsModel | None, CandidateScoring]:
    """Random effects at all locations beyond the parametric ones, and the problem under the noise that they leave, in two turns."""
    linear = projected.linear
    groups, sizes, smooth = random_effects.all_locations(linear, problem.context), None, None
    for _ in range(2):
        new = random_effects.fit_random_effects(conditioned_on_effects(projected, model), groups, sizes)
        if new is None:
            break
        smooth, groups, sizes = new, new.groups, new.sizes
        projected = CandidateScoring.of(linear, noise_left_by(linear, model, smooth, projected.noise, problem.prior_noise))
    return smooth, projected


def noise_left_by(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel, start: Noise, prior: NoisePrior) -> Noise:
    """Noise of what random effects leave, counting the coefficients they used."""
    remaining = linear.with_residual(linear.residual - smooth.columns @ smooth.coefficients)
    noise = noise_with(remaining, model, None, start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - smooth.used, 0.3 * rows))
    return Noise(noise.point * grow, noise.joint * grow, noise.turn * grow)
