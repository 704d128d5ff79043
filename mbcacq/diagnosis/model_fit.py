"""One pass from observations to a model: by evidence; of a long recording, residual tests and random effects at all locations besides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit, fit_evidence
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric import random_effects, residual_tests
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, kept_centres, noise_with, relinearized
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect, RandomEffectOfPose, RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare, thinned, transferred
from mbcacq.diagnosis.reported_model import model_of
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.solution import solved
from mbcacq.effects import unmodelled
from mbcacq.effects.pose import joint_compliance
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "prepare"]


def fit_model(problem: DiagnosisProblem, keep: np.ndarray | None = None, structure_expected: bool = False) -> ModelFit:
    """The model of the centres in keep (M,); without keep, outliers are judged with the model in place.

    structure_expected: of a long recording, in which structure is known to be there.
    """
    if problem.linear.obs.n_poses <= OPTIONS.many_poses:
        return model_of(problem, fit_evidence(problem, keep))
    return fit_long_recording(problem, keep, structure_expected)


def fit_long_recording(problem: DiagnosisProblem, keep: np.ndarray | None, structure_expected: bool) -> ModelFit:
    """The same for a long recording: effects are searched in a part of it, the remainder is random effects at every location."""
    linear = problem.linear if keep is None else problem.linear.restricted(keep)
    small = thinned(problem, linear.keep, OPTIONS.searched_poses)
    # Every arm is elastic: what elasticity explains is not given to slow periodic errors.
    elastic = replace(small, candidates=[c for c in small.candidates if c.name == joint_compliance.NAME])
    soft = fit_evidence(elastic, small.linear.keep, unmodelled=False).best
    found = fit_evidence(small, small.linear.keep, unmodelled=False, begin=soft)
    linear, noise, model = on_the_whole(problem, small, linear, found)
    if keep is None:
        better = reconsidered_outliers(CandidateScoring.of(linear, noise), model)
        if better is not None:
            problem = problem.with_linearization(better)
            small = small.with_linearization(small.linear.restricted(better.keep[rows_of_part(problem, small)]))
        found = fit_evidence(small, small.linear.keep, unmodelled=False, begin=found.best, alternatives=True)
        linear, noise, model = on_the_whole(problem, small, problem.linear, found)
    tests = examine_part(problem, small, model, noise) if keep is None else None
    groups: tuple[RandomEffect, ...] = ()
    sizes = np.zeros(0)
    if structure_expected or (tests is not None and tests.structure):
        asked, sizes, noise = random_effects_everywhere(problem, small, model, noise)
        groups = tuple(g.on(linear, linear.obs) for g in asked)
    projected = CandidateScoring.of(linear, noise)
    # Random effects could explain what parametric effects do, with many more coefficients: here effects are not tested with them in place,
    # but on data left out.
    model = solved(projected, model.effects)
    conditioned = conditioned_on_effects(projected, model)
    smooth = random_effects.solve_random_effects(conditioned, groups, sizes)
    return ModelFit(model, smooth, (), noise, projected, conditioned, found, tests)


def on_the_whole(
    problem: DiagnosisProblem, small: DiagnosisProblem, linear: LinearProblem, found: EvidenceFit
) -> tuple[LinearProblem, Noise, EffectSet]:
    """The effects found in a part of a recording, on all of it: linearised anew with them in place, the noise, and their coefficients."""
    best = reported_hypothesis(found)
    model = transferred(small, problem, EffectSet(tuple((m.candidate, m.hyper) for m in best.catalogued)))
    linear = relinearized(linear, model, best.point.noise)
    noise = noise_with(linear, model, None, best.point.noise, problem.prior_noise)
    return linear, noise, solved(CandidateScoring.of(linear, noise), model.effects)


def reconsidered_outliers(projected: CandidateScoring, model: EffectSet) -> LinearProblem | None:
    """The linearisation with the outliers judged with the model in place; None where they are the same, or too many to be outliers."""
    keep = kept_centres(projected, model)
    if np.array_equal(keep, projected.linear.keep) or np.mean(~keep) >= OPTIONS.most_outliers:
        return None
    return projected.linear.restricted(keep)


def poses_of_part(problem: DiagnosisProblem, small: DiagnosisProblem) -> np.ndarray:
    """(P,) bool of the poses that a thinned recording has."""
    return np.isin(problem.linear.obs.pose_id, small.linear.obs.pose_id)


def rows_of_part(problem: DiagnosisProblem, small: DiagnosisProblem) -> np.ndarray:
    """(M,) bool of its centres."""
    return poses_of_part(problem, small)[problem.linear.obs.pose]


def examine_part(problem: DiagnosisProblem, small: DiagnosisProblem, model: EffectSet, noise: Noise) -> ResidualTests:
    """Residual tests of a thinned recording with the effects found on the whole of it."""
    projected = CandidateScoring.of(small.linear, noise)
    conditioned = conditioned_on_effects(projected, transferred(problem, small, model))
    return residual_tests.examine_residual(conditioned, small.context, EvidenceMap(projected, small.design_blocks))


def random_effects_everywhere(
    problem: DiagnosisProblem, small: DiagnosisProblem, model: EffectSet, noise: Noise
) -> tuple[tuple[RandomEffectOfPose, ...], np.ndarray, Noise]:
    """The random effects at all locations that the data ask for beyond the parametric ones, their sizes, and the noise that they leave.

    Sizes and noise are found in a thinned recording, to a few per cent: the columns of all groups at all poses would take gigabytes.
    """
    there = transferred(problem, small, model)
    linear = relinearized(small.linear, there, noise)
    whole, chosen = problem.linear.obs, poses_of_part(problem, small)
    everywhere = [RandomEffectOfPose.of(problem.context, group) for group in unmodelled.everywhere(problem.context)]
    columns = [g.on(linear, whole, chosen) for g in everywhere]
    groups, sizes = tuple(columns), np.full(len(columns), OPTIONS.initial_size_mm)
    for _ in range(2):
        conditioned = conditioned_on_effects(CandidateScoring.of(linear, noise), there)
        smooth = random_effects.fit_random_effects(conditioned, groups, sizes)
        if smooth is None:
            return (), np.zeros(0), noise
        groups, sizes = smooth.groups, smooth.sizes
        noise = noise_left_by(linear, there, smooth, noise, problem.prior_noise)
    kept = {id(g) for g in groups}
    return tuple(g for g, own in zip(everywhere, columns, strict=True) if id(own) in kept), sizes, noise


def noise_left_by(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel, start: Noise, prior: NoisePrior) -> Noise:
    """Noise of what random effects leave, counting the coefficients they used."""
    remaining = linear.with_residual(linear.residual - smooth.columns @ smooth.coefficients)
    noise = noise_with(remaining, model, None, start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - smooth.used, 0.3 * rows))
    return Noise(noise.point * grow, noise.joint * grow, noise.turn * grow)
