"""One pass from observations to a model: by evidence; of a long recording, residual tests and random effects at all locations besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.allowed_names import with_allowed_names
from mbcacq.diagnosis.evidence.between_sets import ByEffect, by_effect
from mbcacq.diagnosis.evidence.coefficients import relinearized
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit, compared, fit_evidence, kept_centres, with_untried_rivals
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, estimated, under
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import LocatedMismatch, ModelFit, model_of
from mbcacq.diagnosis.nonparametric.joint_model import JointModel, RandomEffect, RandomEffectsModel, noise_with
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare, transferred
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects import unmodelled
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, pack

__all__ = ["DiagnosisProblem", "ModelFit", "fit_model", "fit_part", "prepare"]


def fit_model(problem: DiagnosisProblem) -> ModelFit:
    """The model of all centres; outliers are judged with it in place."""
    return fit_everywhere(problem, search(problem))


@dataclass(frozen=True, kw_only=True)
class Searched:
    """The search for effects. problem: of the poses that were searched, of a long recording a part; members: what is reported, as effects
    of the whole recording."""

    problem: DiagnosisProblem
    fit: EvidenceFit
    members: tuple[Member, ...]


def search(problem: DiagnosisProblem) -> Searched:
    """The sets of effects of the most evidence, and the one that is reported."""
    robot = problem.context.obs.cell.robot
    if not problem.in_part:
        fit = with_allowed_names(with_untried_rivals(problem, fit_evidence(problem)), robot)
        return Searched(problem=problem, fit=fit, members=reported_hypothesis(fit).catalogued)
    part = problem.searched(problem.linear.keep)
    fit = with_untried_rivals(part, compared(part, part.linear, pack(part.noise), alternatives=True, staged=True))
    fit = with_allowed_names(fit, robot)
    return Searched(problem=part, fit=fit, members=transferred(part, problem, reported_hypothesis(fit).catalogued))


def fit_everywhere(problem: DiagnosisProblem, searched: Searched) -> ModelFit:
    """The model of all poses by the effects that were found. A long recording has them fitted to all of it, and what is left are random
    effects at every location.
    """
    found = reported_hypothesis(searched.fit)
    if not problem.in_part:
        return model_of(problem, searched.fit, found, searched.fit.linear)
    point = on_the_whole(problem, searched.members, found)
    # What was refused as a name is unmodelled for certain.
    random, noise, cells = random_effects_everywhere(problem, searched.problem, found, point.noise, known=bool(found.unmodelled))
    if random:
        best = under(replace(point, theta=pack(noise)), searched.members, found.log_prior)
    else:
        best = estimated(searched.members, point, found.log_prior)
    return replace(model_of(problem, searched.fit, best, point.linear), random=random, cells=cells)


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
        noise = noise_left_by(linear, there, joint.random_effects, noise, problem.prior_noise)
    chosen_groups = ((e, s * g.sigma) for e, g, s in zip(everywhere, groups, sizes, strict=True) if s > 0)
    return tuple(replace(e, sigma=sigma) for e, sigma in chosen_groups), noise, cells


def noise_left_by(linear: LinearProblem, model: EffectSet, smooth: RandomEffectsModel, start: Noise, prior: NoisePrior) -> Noise:
    """Noise of what random effects leave, counting the coefficients they used."""
    remaining = linear.with_residual(linear.residual - smooth.displacement(linear))
    noise = noise_with(remaining, model, start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - smooth.used, 0.3 * rows))
    return Noise(noise.point * grow, noise.joint * grow, noise.turn * grow)
