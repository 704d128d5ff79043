"""The most probable set of effects as the model that is validated, reported and drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.coupled_effects import coupled
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, first_order
from mbcacq.diagnosis.evidence.moments import with_moment_uncertainty
from mbcacq.diagnosis.fitted_model import LocatedMismatch, ModelFit
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect, RandomEffectsModel, conditioned_on_effects
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.estimation.linear_problem import LinearProblem


def model_of(problem: DiagnosisProblem, fit: EvidenceFit, best: Hypothesis, linear: LinearProblem) -> ModelFit:
    """Parametric effects with their coefficients, unmodelled ones as random effects, and the noise with both in place. best: the set that
    is reported; linear: its linearisation, without discrepancy.
    """
    projected = CandidateScoring.of(linear, best.point.noise)
    agreed = coupled(problem.candidates, problem.context, best)
    members, values, covariance = part_of(agreed, lambda m: m in agreed.catalogued)
    model = EffectSet(tuple(replace(m, candidate=with_moment_uncertainty(agreed, m)) for m in members), values, covariance)
    conditioned = conditioned_on_effects(projected, model)
    model = replace(model, gain=projected.chi2 - conditioned.chi2)
    estimated = random_effects(best) if best.unmodelled else None
    groups = estimated.groups if estimated else ()
    return ModelFit(
        model=model,
        random=groups,
        cells=cells_of(best),
        noise=best.point.noise,
        geometry_only=projected,
        conditioned=conditioned,
        evidence=fit,
        estimated=estimated,
    )


def part_of(hypothesis: Hypothesis, chosen: Callable[[Member], bool]) -> tuple[list[Member], np.ndarray, np.ndarray]:
    """Some effects of a hypothesis, their coefficients (k,) and the covariance (k, k) of these."""
    found = coefficients(hypothesis)
    own = [(m, p) for m, p in zip(hypothesis.members, found.slices(), strict=True) if chosen(m)]
    index = np.concatenate([np.zeros(0, int), *(np.arange(p.start, p.stop) for _, p in own)])
    return [m for m, _ in own], found.coefficients[index], found.covariance[np.ix_(index, index)]


def random_effects(best: Hypothesis) -> RandomEffectsModel:
    """The unmodelled effects of a hypothesis."""
    members, values, covariance = part_of(best, lambda m: m in best.unmodelled)
    linear = best.point.linear
    moved = [tuple(candidate_parts(linear, m.candidate)) for m in members]
    groups = tuple(
        RandomEffect(m.candidate.where[0], m.candidate.depends_on, parts, m.size * m.candidate.typical)
        for m, parts in zip(members, moved, strict=True)
    )
    return RandomEffectsModel(groups, values, covariance)


def cells_of(best: Hypothesis) -> tuple[LocatedMismatch, ...]:
    """Where the unmodelled effects are, each with the evidence that the hypothesis loses without it."""
    cells = []
    for m in best.unmodelled:
        rest = tuple(other for other in best.members if other is not m)
        lost = best.log_evidence - first_order(rest, best.point, 0.0).log_evidence
        cells.append(LocatedMismatch(m.candidate.where[0], m.candidate.depends_on, lost))
    return tuple(cells)
