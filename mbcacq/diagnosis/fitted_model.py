"""The model that one pass over a recording has found, and by how much chi2 rises without each of its effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.coupled_effects import coupled
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, first_order
from mbcacq.diagnosis.evidence.moments import with_moment_uncertainty
from mbcacq.diagnosis.nonparametric.joint_model import JointModel, RandomEffect, RandomEffectsModel, conditioned_on_effects
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.random_effect_sizes import joined
from mbcacq.estimation.whitened_columns import Posterior


@dataclass(frozen=True)
class LocatedMismatch:
    """Where an unmodelled effect is, the covariate that it depends on, and the log Bayes factor that it adds to all else."""

    location: str
    depends_on: str
    log_bayes_factor: float


@dataclass(frozen=True, kw_only=True)
class ModelFit:
    """The model that one pass has found.

    Attributes
    ----------
    model : EffectSet
        Parametric effects.
    random : tuple[RandomEffect, ...]
        Random effects, their priors known.
    cells : tuple[LocatedMismatch, ...]
        Where the evidence put unmodelled effects.
    noise : Noise
        Estimated with both in place.
    geometry_only, conditioned : CandidateScoring
        The projected problem under that noise, with geometry alone and conditioned on the parametric effects.
    evidence : EvidenceFit
        The hypotheses that were compared, of a long recording on a part of it.
    estimated : RandomEffectsModel or None
        The random effects with the coefficients that the evidence gives them; None where they stand at all locations.
    """

    model: EffectSet
    random: tuple[RandomEffect, ...]
    cells: tuple[LocatedMismatch, ...]
    noise: Noise
    geometry_only: CandidateScoring
    conditioned: CandidateScoring
    evidence: EvidenceFit
    estimated: RandomEffectsModel | None = None

    @cached_property
    def joint(self) -> JointModel:
        """Everything as one linear problem."""
        return JointModel(self.geometry_only.linear, self.model, self.random, self.geometry_only.whiten)

    @cached_property
    def random_effects(self) -> RandomEffectsModel | None:
        """The random effects with their coefficients; None where there are none."""
        return self.estimated or (self.joint.random_effects if self.random else None)

    def stated(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (k,) of a parametric effect and their covariance (k, k), with the random effects at all locations unknown beside it:
        what these could do as well is in the uncertainty. A group at its own place of its own covariate is left out: what both have in
        common is the effect.
        """
        candidate, own = self.model.members[number].candidate, self.model.slices()[number]
        if not self.everywhere:
            return self.model.coefficients[own], self.model.covariance[own, own]
        joint, place = self.joint, (candidate.where[0], candidate.depends_on)
        if place not in self._beside:
            others = [g for g, one in enumerate(self.random) if (one.location, one.depends_on) != place]
            index = joint.index(range(len(joint.effects)), others)
            self._beside[place] = Posterior(joint.sigma[index], joint.products.of_columns(index))
        at = np.arange(joint.effects[number].start, joint.effects[number].stop)
        return self._beside[place].solution[at], self._beside[place].covariance_of(at)

    @cached_property
    def _beside(self) -> dict[tuple[str, str], Posterior]:
        return {}

    @property
    def everywhere(self) -> bool:
        """Whether there are random effects at all locations, which could do what parametric effects do."""
        return bool(self.random) and self.estimated is None

    @property
    def empty(self) -> bool:
        """Whether nothing was found."""
        return not self.random and not self.model.members

    def without_random_effects(self) -> ModelFit:
        return replace(self, random=(), estimated=None)


class Contributions:
    """Contributions of the parametric effects of a fit, numbered as there, and of the groups of its unmodelled effects, numbered after
    them, on the data of the fit.
    """

    def __init__(self, full: ModelFit):
        joint = full.joint
        first = len(joint.geometry)
        self._parts = [slice(p.start - first, p.stop - first) for p in (*joint.effects, *joint.groups)]
        self._everywhere, count = full.everywhere, len(joint.effects)
        self.named, self.unmodelled = list(range(count)), list(range(count, len(self._parts)))
        if self._parts:
            S, self._b = joint.beyond(joint.geometry)
            self._S = S + np.eye(len(S))

    def of(self, which: Sequence[int]) -> float:
        """The chi2 that these effects and groups explain and the others cannot. Groups that stand at all locations could do what parametric
        effects do: they come after these.
        """
        after = self._everywhere and set(which) <= set(self.named)
        considered = self.named if after else self.named + self.unmodelled
        return self._explained(considered) - self._explained([j for j in considered if j not in which])

    def _explained(self, which: list[int]) -> float:
        """chi2 that these explain together."""
        index = joined([self._parts[j] for j in which])
        return float(self._b[index] @ np.linalg.solve(self._S[np.ix_(index, index)], self._b[index])) if which else 0.0

    def groups_at(self, full: ModelFit, at: str, depends_on: str | None = None) -> list[int]:
        """Numbers of the groups at a location, of one covariate or of all; where they stand at all locations, those of all."""
        chosen = (g.location == at and depends_on in (None, g.depends_on) or self._everywhere for g in full.random)
        return [number for number, mine in zip(self.unmodelled, chosen, strict=True) if mine]


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
    moved = [tuple(candidate_parts(linear, m.candidate, m.hyper)) for m in members]
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
