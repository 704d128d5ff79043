"""One pass from observations to a model: by evidence, or, of a long recording, search, residual tests, random effects at all locations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import fit_evidence
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric import random_effects, residual_tests
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, kept_centres, noise_with, relinearized
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare, thinned, transferred
from mbcacq.diagnosis.reported_model import model_of
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.diagnosis.search.pruning import pruned
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "prepare", "search_parametric_effects"]


@dataclass(frozen=True)
class SearchResult:
    """Parametric effects, the noise with them in place, the search that found them, the linearisation with them in place."""

    model: EffectSet
    noise: Noise
    search: BeamSearch
    linear: LinearProblem


def search_parametric_effects(problem: DiagnosisProblem, linear: LinearProblem, plain: Noise, relinearize: bool = True) -> SearchResult:
    """Parametric effects of a long recording, noise and linearisation in two turns. plain: noise with geometry alone."""
    search, noise, model = beam_search_for(problem), plain, NO_EFFECTS
    for number in range(2 if relinearize else 1):
        projected = CandidateScoring.of(linear, noise)
        start = model
        if number == 0:
            start = elastic_joints(problem, projected)
            search = replace(search, protected=frozenset(c.key for c, _ in start.effects))
        new = search.polished(projected, search.beam_search(projected, start))
        same = {c.key for c, _ in new.effects} == {c.key for c, _ in model.effects}
        model = new
        if not model.effects:
            break
        noise = noise_with(linear, model, None, noise, problem.prior_noise)
        for _ in range(2 * relinearize):
            linear = relinearized(linear, model, noise)
        if same:
            break
    return SearchResult(model, noise, search, linear)


def beam_search_for(problem: DiagnosisProblem) -> BeamSearch:
    """The search of a long recording, with a narrow beam."""
    return BeamSearch(problem.candidates, beam_width=1, branches=3, rounds=5, thorough=False, least_share=0.003)


def elastic_joints(problem: DiagnosisProblem, projected: CandidateScoring) -> EffectSet:
    """Every arm is elastic: what elasticity explains is not given to slow periodic errors."""
    elastic = [c for c in problem.candidates if c.name == "joint_compliance"]
    return BeamSearch(elastic, beam_width=1, branches=2, rounds=6).run(projected)


def fit_model(
    problem: DiagnosisProblem, keep: np.ndarray | None = None, reconsider: bool = True, structure_expected: bool = False
) -> ModelFit:
    """The model of the centres in keep (M,); without keep, outliers are judged with the model in place.

    structure_expected: of a long recording, in which structure is known to be there.
    """
    if problem.linear.obs.n_poses <= OPTIONS.many_poses:
        return model_of(problem, fit_evidence(problem, keep))
    linear = problem.linear if keep is None else problem.linear.restricted(keep)
    return fit_long_recording(problem, linear, keep, reconsider, structure_expected)


def reconsidered_outliers(projected: CandidateScoring, model: EffectSet) -> LinearProblem | None:
    """The linearisation with the outliers judged with the model in place; None where they are the same, or too many to be outliers."""
    keep = kept_centres(projected, model)
    if np.array_equal(keep, projected.linear.keep) or np.mean(~keep) >= OPTIONS.most_outliers:
        return None
    return projected.linear.restricted(keep)


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
