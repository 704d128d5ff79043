"""One pass from observations to a model: by evidence; of a long recording, residual tests and random effects at all locations besides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit, fit_evidence
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric import residual_tests
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.joint_model import JointModel, conditioned_on_effects, kept_centres, noise_with, relinearized
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect, RandomEffectsModel
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

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "fit_part", "prepare"]


def fit_model(problem: DiagnosisProblem) -> ModelFit:
    """The model of all centres; outliers are judged with it in place."""
    if problem.linear.obs.n_poses <= OPTIONS.many_poses:
        return model_of(problem, fit_evidence(problem))
    return fit_long_recording(problem)


def fit_part(problem: DiagnosisProblem, keep: np.ndarray, structure_expected: bool) -> tuple[EffectSet, tuple[RandomEffect, ...]]:
    """The effects and random effects that the centres in keep (M,) bool speak for; of a long recording without coefficients.

    structure_expected: of a long recording, in which structure is known to be there.
    """
    if problem.linear.obs.n_poses <= OPTIONS.many_poses:
        found = model_of(problem, fit_evidence(problem, keep))
        return found.model, found.random
    small = thinned(problem, keep, OPTIONS.searched_poses)
    best = reported_hypothesis(searched(small))
    there = effects_of(best)
    random = random_effects_everywhere(problem, small, there, best.point.noise)[0] if structure_expected else ()
    return transferred(small, problem, there), random


def searched(small: DiagnosisProblem) -> EvidenceFit:
    """The effects by evidence, those of the joints' elasticity first."""
    # Every arm is elastic: what elasticity explains is not given to slow periodic errors.
    elastic = replace(small, candidates=[c for c in small.candidates if c.name == joint_compliance.NAME])
    soft = fit_evidence(elastic, small.linear.keep, unmodelled=False).best
    return fit_evidence(small, small.linear.keep, unmodelled=False, begin=soft)


def effects_of(hypothesis: Hypothesis) -> EffectSet:
    """The effects of the catalogue of a hypothesis, without coefficients."""
    return EffectSet(tuple((m.candidate, m.hyper) for m in hypothesis.catalogued))


def fit_long_recording(problem: DiagnosisProblem) -> ModelFit:
    """The same for a long recording: effects are searched in a part of it, the remainder is random effects at every location."""
    small = thinned(problem, problem.linear.keep, OPTIONS.searched_poses)
    found = searched(small)
    better = reconsidered_outliers(problem, small, reported_hypothesis(found))
    if better is not None:
        problem = problem.with_linearization(better)
        small = small.with_linearization(small.linear.restricted(better.keep[poses_of_part(problem, small)[problem.linear.obs.pose]]))
    found = fit_evidence(small, small.linear.keep, unmodelled=False, begin=found.best, alternatives=True)
    linear, noise, model = on_the_whole(problem, small, found)
    there = effects_of(reported_hypothesis(found))
    tests = examine_part(small, there, noise)
    groups: tuple[RandomEffect, ...] = ()
    if tests.structure:
        groups, noise = random_effects_everywhere(problem, small, there, noise)
    projected = CandidateScoring.of(linear, noise)
    # Random effects could explain what parametric effects do, with many more coefficients: here effects are not tested with them in place,
    # but on data left out.
    model = solved(projected, model.effects)
    return ModelFit(model, groups, (), noise, projected, conditioned_on_effects(projected, model), found, tests)


def on_the_whole(problem: DiagnosisProblem, small: DiagnosisProblem, found: EvidenceFit) -> tuple[LinearProblem, Noise, EffectSet]:
    """The effects found in a part of a recording, on all of it: linearised anew with them in place, the noise, and they themselves, without
    coefficients.
    """
    best = reported_hypothesis(found)
    model = transferred(small, problem, effects_of(best))
    linear = relinearized(problem.linear, model, best.point.noise)
    noise = noise_with(linear, model, best.point.noise, problem.prior_noise)
    return linear, noise, model


def reconsidered_outliers(problem: DiagnosisProblem, small: DiagnosisProblem, best: Hypothesis) -> LinearProblem | None:
    """The linearisation with the outliers judged with the effects of a part in place; None where they are the same, or too many to be
    outliers.
    """
    linear = problem.linear
    keep = kept_centres(CandidateScoring.of(linear, best.point.noise), transferred(small, problem, effects_of(best)))
    return None if np.array_equal(keep, linear.keep) or np.mean(~keep) >= OPTIONS.most_outliers else linear.restricted(keep)


def poses_of_part(problem: DiagnosisProblem, small: DiagnosisProblem) -> np.ndarray:
    """(P,) bool of the poses that a thinned recording has."""
    return np.isin(problem.linear.obs.pose_id, small.linear.obs.pose_id)


def examine_part(small: DiagnosisProblem, model: EffectSet, noise: Noise) -> ResidualTests:
    """Residual tests of a thinned recording with effects in place."""
    projected = CandidateScoring.of(small.linear, noise)
    return residual_tests.examine_residual(conditioned_on_effects(projected, model), EvidenceMap(projected, small.design_blocks.groups))


def random_effects_everywhere(
    problem: DiagnosisProblem, small: DiagnosisProblem, there: EffectSet, noise: Noise
) -> tuple[tuple[RandomEffect, ...], Noise]:
    """The random effects at all locations that the data ask for beyond the parametric ones, and the noise that they leave.
    there: the parametric ones, of the thinned recording.

    Sizes and noise are found in a thinned recording, to a few per cent; coefficients take all of it.
    """
    linear = relinearized(small.linear, there, noise)
    whole, chosen = problem.linear.obs, poses_of_part(problem, small)
    everywhere = [RandomEffect.of(problem.context, group) for group in unmodelled.everywhere(problem.context)]
    groups = [g.of_poses(chosen, whole.pose).of_unit_size(linear) for g in everywhere]
    sizes = np.full(len(groups), OPTIONS.initial_size_mm)
    for _ in range(2):
        alive = np.flatnonzero(sizes > 0)
        sizes[alive] = JointModel(linear, there, [groups[g] for g in alive], linear.whitener(noise)).group_sizes(sizes[alive])
        sized = [replace(groups[g], sigma=sizes[g] * groups[g].sigma) for g in np.flatnonzero(sizes > 0)]
        if not sized:
            return (), noise
        smooth = JointModel(linear, there, sized, linear.whitener(noise)).random_effects
        noise = noise_left_by(linear, there, smooth, noise, problem.prior_noise)
    chosen_groups = ((e, s * g.sigma) for e, g, s in zip(everywhere, groups, sizes, strict=True) if s > 0)
    return tuple(replace(e, sigma=sigma) for e, sigma in chosen_groups), noise


def noise_left_by(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel, start: Noise, prior: NoisePrior) -> Noise:
    """Noise of what random effects leave, counting the coefficients they used."""
    remaining = linear.with_residual(linear.residual - smooth.displacement(linear))
    noise = noise_with(remaining, model, start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - smooth.used, 0.3 * rows))
    return Noise(noise.point * grow, noise.joint * grow, noise.turn * grow)
