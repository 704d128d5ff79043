"""One pass from observations to a model: by evidence; of a long recording, residual tests and random effects at all locations besides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import fit_evidence
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric import random_effects, residual_tests
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, kept_centres, noise_with, relinearized
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare, thinned, transferred
from mbcacq.diagnosis.reported_model import model_of
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.solution import solved
from mbcacq.effects.pose import joint_compliance
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "prepare"]


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
    # Every arm is elastic: what elasticity explains is not given to slow periodic errors.
    elastic = replace(small, candidates=[c for c in small.candidates if c.name == joint_compliance.NAME])
    soft = fit_evidence(elastic, small.linear.keep, unmodelled=False).best
    found = fit_evidence(small, small.linear.keep, unmodelled=False, begin=soft, alternatives=keep is None)
    best = reported_hypothesis(found)
    model = transferred(small, problem, EffectSet(tuple((m.candidate, m.hyper) for m in best.catalogued)))
    linear = relinearized(linear, model, best.point.noise)
    noise = noise_with(linear, model, None, best.point.noise, problem.prior_noise)
    projected = CandidateScoring.of(linear, noise)
    model = solved(projected, model.effects)
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
    model = solved(projected, model.effects)
    conditioned = conditioned_on_effects(projected, model)
    if smooth is not None:
        smooth = random_effects.fit_random_effects(conditioned, smooth.groups, smooth.sizes) or smooth
    return ModelFit(model, smooth, (), projected.noise, projected, conditioned, found, tests)


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
