"""The model of a recording by one pass: effects by their evidence, and random effects at all locations of a long one.

It knows by how much chi2 rises without each of its effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.evidence.allowed_names import with_allowed_names
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.between_sets import ByEffect, by_effect
from mbcacq.diagnosis.evidence.coupled_effects import coupled
from mbcacq.diagnosis.evidence.evidence_fit import compared, fit_evidence, kept_centres, relinearized, with_untried_rivals
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, estimated, first_order, under
from mbcacq.diagnosis.evidence.moments import with_moment_uncertainty
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.nonparametric.joint_model import JointModel, RandomEffect, conditioned_on_effects, noise_with
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, transferred
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects import unmodelled
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.random_effect_sizes import joined
from mbcacq.estimation.variance_components import NoisePrior, first_noise, pack
from mbcacq.estimation.whitened_columns import Posterior

SIGNIFICANT = 3.0  # standard deviations by which joints must repeat worse than their data sheet has it


@dataclass(frozen=True)
class LocatedMismatch:
    """Where an unmodelled effect is, the covariate that it depends on, and the log Bayes factor that it adds to all else."""

    location: str
    depends_on: str
    log_bayes_factor: float


@dataclass(frozen=True)
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
    estimated : EffectSet or None
        The random effects with the coefficients that the evidence gives them; None if they stand at all locations.
    """

    model: EffectSet
    random: tuple[RandomEffect, ...]
    cells: tuple[LocatedMismatch, ...]
    noise: Noise
    geometry_only: CandidateScoring
    conditioned: CandidateScoring
    evidence: EvidenceFit
    estimated: EffectSet | None = None

    @cached_property
    def joint(self) -> JointModel:
        """Everything as one linear problem."""
        return JointModel(self.geometry_only.linear, self.model, self.random, self.geometry_only.whiten)

    @cached_property
    def random_effects(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (k,) of the random effects and their covariance (k, k)."""
        return self.joint.random_effects if self.estimated is None else (self.estimated.coefficients, self.estimated.covariance)

    def stated(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (k,) of a parametric effect and their covariance (k, k), with unknown random effects at all locations, which widen
        the covariance. A group at its own place of its own covariate is left out: what both have in common is the effect.
        """
        candidate, own = self.model.members[number].candidate, self.model.slices()[number]
        if not self.everywhere:
            return self.model.coefficients[own], self.model.covariance[own, own]
        joint, place = self.joint, (candidate.where[0], candidate.depends_on)
        if place not in self._with_other_groups:
            others = [g for g, one in enumerate(self.random) if (one.location, one.depends_on) != place]
            index = joint.index(range(len(joint.effects)), others)
            self._with_other_groups[place] = Posterior(joint.sigma[index], joint.products.of_columns(index))
        at = np.arange(joint.effects[number].start, joint.effects[number].stop)
        return self._with_other_groups[place].solution[at], self._with_other_groups[place].covariance_of(at)

    @cached_property
    def _with_other_groups(self) -> dict[tuple[str, str], Posterior]:
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
    named = agreed.solved.part(lambda m: m.candidate.name != UNKNOWN)
    model = replace(named, members=tuple(replace(m, candidate=with_moment_uncertainty(agreed, m)) for m in named.members))
    conditioned = conditioned_on_effects(projected, model)
    model = replace(model, gain=projected.chi2 - conditioned.chi2)
    estimated = best.solved.part(lambda m: m.candidate.name == UNKNOWN) if best.unmodelled else None
    random = () if estimated is None else random_effects(best.point.linear, estimated)
    return ModelFit(model, random, cells_of(best), best.point.noise, projected, conditioned, fit, estimated=estimated)


def random_effects(linear: LinearProblem, found: EffectSet) -> tuple[RandomEffect, ...]:
    """Unmodelled effects as groups, at the sizes that are most probable."""
    moved = [tuple(candidate_parts(linear, m.candidate, m.hyper)) for m in found.members]
    return tuple(
        RandomEffect(m.candidate.where[0], m.candidate.depends_on, parts, m.size * m.candidate.typical)
        for m, parts in zip(found.members, moved, strict=True)
    )


def cells_of(best: Hypothesis) -> tuple[LocatedMismatch, ...]:
    """Where the unmodelled effects are, each with the evidence that the hypothesis loses without it."""
    cells = []
    for m in best.unmodelled:
        rest = tuple(other for other in best.members if other is not m)
        lost = best.log_evidence - first_order(rest, best.point, 0.0).log_evidence
        cells.append(LocatedMismatch(m.candidate.where[0], m.candidate.depends_on, lost))
    return tuple(cells)


def fit_model(problem: DiagnosisProblem) -> ModelFit:
    """The model of all centres; outliers are judged with it in place."""
    return fit_everywhere(problem, *search(problem))


def search(problem: DiagnosisProblem) -> tuple[DiagnosisProblem, EvidenceFit, tuple[Member, ...]]:
    """The problem of the poses that were searched, of a long recording a part; the sets of effects; and the effects of the catalogue that
    are reported, as those of the whole recording."""
    robot = problem.context.obs.cell.robot
    if not problem.in_part:
        fit = with_allowed_names(with_untried_rivals(problem, fit_evidence(problem)), robot)
        return problem, fit, reported_hypothesis(fit).catalogued
    part = problem.searched(problem.linear.keep)
    fit = with_untried_rivals(part, compared(part, part.linear, pack(part.noise), alternatives=True, staged=True))
    fit = with_allowed_names(fit, robot)
    return part, fit, transferred(part, problem, reported_hypothesis(fit).catalogued)


def fit_everywhere(problem: DiagnosisProblem, part: DiagnosisProblem, fit: EvidenceFit, members: Sequence[Member]) -> ModelFit:
    """The model of all poses by the effects that were found. A long recording has them fitted to all of it, and what is left are random
    effects at every location.
    """
    found = reported_hypothesis(fit)
    if not problem.in_part:
        return model_of(problem, fit, found, fit.linear)
    point = on_the_whole(problem, members, found)
    # What was refused as a name is unmodelled for certain.
    random, noise, cells = random_effects_everywhere(problem, part, found, point.noise, known=bool(found.unmodelled))
    if random:
        best = under(replace(point, theta=pack(noise)), members, found.log_prior)
    else:
        best = estimated(members, point, found.log_prior)
    return replace(model_of(problem, fit, best, point.linear), random=random, cells=cells)


@dataclass(frozen=True, kw_only=True)
class PartModel:
    """What a part of a recording shows. model: the effects, those of a long recording without coefficients; stated: what the part states of
    each, by ``name:where``."""

    model: EffectSet
    random: tuple[RandomEffect, ...]
    stated: ByEffect


def fit_part(problem: DiagnosisProblem, keep: np.ndarray, unmodelled: bool) -> PartModel:
    """The effects and random effects that the centres in keep (M,) bool speak for.

    unmodelled: of a long recording, whether there is anything but effects of the catalogue.
    """
    part = problem.searched(keep)
    fit = compared(part, part.linear, pack(part.noise), narrow=not problem.in_part, staged=problem.in_part)
    fit = with_allowed_names(fit, part.context.obs.cell.robot)
    best = reported_hypothesis(fit)
    if not problem.in_part:
        found = model_of(problem, fit, best, part.linear)
        return PartModel(model=found.model, random=found.random, stated=by_effect(found.model))
    random = random_effects_everywhere(problem, part, best, best.point.noise, known=True)[0] if unmodelled else ()
    stated = by_effect(model_of(part, fit, best, part.linear).model)
    return PartModel(model=EffectSet(transferred(part, problem, best.catalogued)), random=random, stated=stated)


def on_the_whole(problem: DiagnosisProblem, members: Sequence[Member], found: Hypothesis) -> NoisePoint:
    """All of a recording with the effects in place that were found in a part of it: outliers judged and linearised anew."""
    whole = estimated(members, NoisePoint(problem.linear, problem.prior_noise, found.point.theta), found.log_prior)
    return replace(whole.point, linear=relinearized(problem.linear, whole).restricted(kept_centres(whole)))


def groups_everywhere(problem: DiagnosisProblem) -> list[RandomEffect]:
    """The groups that may stand at all locations of a long recording, their sizes not known."""
    here = problem.context
    return here.computed_once(("groups everywhere",), lambda: [RandomEffect.of(here, group) for group in unmodelled.everywhere(here)])


def random_effects_everywhere(
    problem: DiagnosisProblem, small: DiagnosisProblem, found: Hypothesis, noise: Noise, known: bool = False
) -> tuple[tuple[RandomEffect, ...], Noise, tuple[LocatedMismatch, ...]]:
    """The random effects at all locations that the data ask for beyond the parametric ones, the noise that they leave, and their locations,
    that of most evidence first. found: the set of effects of the thinned recording.

    There are no random effects if their evidence does not exceed their prior odds, in which each group is one more effect; ``known`` skips
    this test. Sizes and noise are found in a thinned recording, to a few per cent; coefficients take all of it.
    """
    there, linear = EffectSet(found.catalogued), relinearized(small.linear, replace(found, members=found.catalogued))
    whole, chosen = problem.linear.obs, np.isin(problem.linear.obs.pose_id, small.linear.obs.pose_id)
    everywhere = groups_everywhere(problem)
    groups = [g.of_poses(chosen, whole.pose).of_unit_size(linear) for g in everywhere]
    sizes = np.full(len(groups), np.mean(noise.point))
    cells: tuple[LocatedMismatch, ...] = ()
    for turn in range(2):
        alive = np.flatnonzero(sizes > 0)
        sizes[alive] = JointModel(linear, there, [groups[g] for g in alive], linear.whitener(noise)).group_sizes(sizes[alive])
        sized = [replace(groups[g], sigma=sizes[g] * groups[g].sigma) for g in np.flatnonzero(sizes > 0)]
        if not sized:
            return (), noise, ()
        joint = JointModel(linear, there, sized, linear.whitener(noise))
        if turn == 0:
            together, each = joint.log_bayes_factors()
            if not known and together + len(sized) * np.log(OPTIONS.further) + np.log(OPTIONS.unmodelled) < 0:
                return (), noise, ()
            best = {sized[g].location: LocatedMismatch(sized[g].location, sized[g].depends_on, float(each[g])) for g in np.argsort(each)}
            cells = tuple(sorted(best.values(), key=lambda cell: -cell.log_bayes_factor))
        noise = noise_left_by(joint, noise, problem.prior_noise)
    chosen_groups = ((e, s * g.sigma) for e, g, s in zip(everywhere, groups, sizes, strict=True) if s > 0)
    return tuple(replace(e, sigma=sigma) for e, sigma in chosen_groups), noise, cells


def noise_left_by(joint: JointModel, start: Noise, prior: NoisePrior) -> Noise:
    """Noise of what random effects leave, counting the coefficients they used."""
    linear, (coefficients, covariance) = joint.linear, joint.random_effects
    moved = joint.displacement(np.r_[np.zeros(len(joint.sigma) - len(coefficients)), coefficients])
    noise = noise_with(linear.with_residual(linear.residual - moved), joint.model, start, prior)
    rows = float(linear.keep.sum() * linear.width)
    used = float(np.sum(1.0 - np.diag(covariance) / joint.sigma[-len(coefficients) :] ** 2))
    grow = np.sqrt(rows / max(rows - used, 0.3 * rows))
    return Noise(noise.point * grow, noise.joint * grow, noise.turn * grow)


def joint_noise_factor(full: ModelFit) -> float:
    """Repeatability of the joints over that of the data sheet (median). It is 1 if the joints are no worse beyond chance, or if the sheet
    states none.

    What repeats worse than that is an error that was not recognised: no verdict takes it for noise.
    """
    cell, dof = full.geometry_only.linear.obs.cell, full.geometry_only.dof
    if not cell.robot.repeatability_mm:
        return 1.0
    factor = float(np.median(full.noise.joint / first_noise(cell).joint))
    scatter = 1.0 + SIGNIFICANT / np.sqrt(2.0 * max(dof, 1.0))
    return factor if factor > OPTIONS.noticeable * scatter else 1.0
