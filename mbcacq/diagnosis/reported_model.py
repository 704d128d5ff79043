"""The most probable set of effects as the model that is validated, reported and drawn."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, first_order
from mbcacq.diagnosis.evidence.moments import with_moment_uncertainty
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric.evidence_map import MapCell
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect, RandomEffectsModel
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search import payload_coupling
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.pose import payload


def model_of(problem: DiagnosisProblem, fit: EvidenceFit) -> ModelFit:
    """Parametric effects with their coefficients, unmodelled ones as random effects, and the noise with both in place."""
    best = reported_hypothesis(fit)
    projected = CandidateScoring.of(fit.linear, best.point.noise)
    found = coefficients(best)
    chosen = [j for j, m in enumerate(best.members) if m in best.catalogued]
    index = np.concatenate([np.zeros(0, int), *(np.arange(found.slices[j].start, found.slices[j].stop) for j in chosen)])
    effects = tuple((with_moment_uncertainty(best, best.members[j]), best.members[j].hyper) for j in chosen)
    model = EffectSet(effects, coefficients=found.mean[index], covariance=found.covariance[np.ix_(index, index)])
    if payload.NAME in model.names:
        model = payload_coupling.coupled(problem.candidates, problem.context, projected, model)
    conditioned = conditioned_on_effects(projected, model)
    model = EffectSet(model.effects, projected.chi2 - conditioned.chi2, model.coefficients, model.covariance)
    cells = tuple(cell_at(best, m) for m in best.unmodelled)
    estimated = random_effects(best)
    groups = estimated.groups if estimated else ()
    return ModelFit(model, groups, cells, best.point.noise, projected, conditioned, fit, estimated=estimated)


def random_effects(best: Hypothesis) -> RandomEffectsModel | None:
    """The unmodelled effects of a hypothesis."""
    if not best.unmodelled:
        return None
    found = coefficients(best)
    chosen = [j for j, m in enumerate(best.members) if m in best.unmodelled]
    members = [best.members[j] for j in chosen]
    groups = tuple(
        RandomEffect(m.candidate.where[0], m.candidate.depends_on, tuple(m.candidate.build(None)), m.size * m.candidate.typical)
        for m in members
    )
    values = np.concatenate([found.mean[found.slices[j]] for j in chosen])
    sigma = np.concatenate([g.sigma for g in groups])
    index = np.concatenate([np.arange(found.slices[j].start, found.slices[j].stop) for j in chosen])
    covariance = found.covariance[np.ix_(index, index)]
    used = float(np.sum(1.0 - np.diag(covariance) / sigma**2))
    return RandomEffectsModel(groups, values, used, covariance)


def cell_at(best: Hypothesis, member: Member) -> MapCell:
    """The unmodelled effect as a cell of the evidence map, with the evidence that the hypothesis loses without it."""
    rest = tuple(m for m in best.members if m is not member)
    lost = best.log_evidence - first_order(rest, best.point, 0.0).log_evidence
    return MapCell(member.candidate.where[0], member.candidate.depends_on, lost)
