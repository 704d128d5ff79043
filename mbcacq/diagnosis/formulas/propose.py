"""Formulas for the unmodelled effects of a diagnosis: found on all data, scored on data left out."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.formulas.dictionary import MOST_SEARCHES, PROPOSED, SCATTERS
from mbcacq.diagnosis.formulas.search import NAME, Formula, FormulaSearch, FormulaSpace, PlacedTerm, candidate, described, different
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.nonparametric.basis_functions import Location, locations_of_arm, scanner_location
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.diagnosis.problem import DiagnosisProblem, thinned, transferred
from mbcacq.diagnosis.result import Proposal
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.diagnosis.validation.cross_validation import summed
from mbcacq.diagnosis.validation.folds import split
from mbcacq.diagnosis.validation.predictive_score import HeldOutPrediction, PredictiveScore
from mbcacq.effects import unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.effect_term import UNKNOWN, EffectTerm
from mbcacq.effects.learnt_range import learnt_ranges
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.variance_components import pack


@dataclass(frozen=True)
class Setting:
    """The data in which formulas are sought and on which they are scored, every unmodelled effect taken out.

    linear, point: the recording, and its noise with everything found in place. others: the parametric effects. random: the unmodelled
    ones (none where these stand at all locations).
    """

    context: Context
    linear: LinearProblem
    point: NoisePoint
    others: tuple[Member, ...]
    random: tuple[RandomEffect, ...] = ()

    @classmethod
    def of(cls, problem: DiagnosisProblem, full: ModelFit) -> Setting:
        """The setting of a recording; of a long one, some of its poses."""
        linear = full.geometry_only.linear
        if not full.everywhere:
            best = reported_hypothesis(full.evidence)
            return cls(problem.context, linear, best.point, best.catalogued, full.random)
        small = thinned(problem, linear.keep, unmodelled.OPTIONS.many_poses)
        others = transferred(problem, small, full.model.members)
        return cls(small.context, small.linear, NoisePoint(small.linear, problem.prior_noise, pack(full.noise)), others)

    @cached_property
    def parts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """(M,) bool of the centres of all other parts of the data, and of those of each part."""
        pose, keep = self.linear.obs.pose, self.linear.keep
        fold = split(self.linear, DIAGNOSIS.folds)[0]
        return [(keep & (fold != k)[pose], keep & (fold == k)[pose]) for k in range(int(fold.max()) + 1)]

    def scores(self, formula: Formula | None = None, random: Sequence[RandomEffect] = ()) -> list[PredictiveScore]:
        """Scores of each part: the parametric effects with others, fitted without the part and evaluated on it."""
        effects = list(self.others)
        if formula is not None:
            effects.append(Member(candidate(self.context, formula.placed, formula.sigma / DIAGNOSIS.sizes[-1]), None))
        model, noise = EffectSet(tuple(effects)), self.point.noise
        return [HeldOutPrediction(self.linear, train, test, model, random, noise).score() for train, test in self.parts]


def holds_up(proposal: Proposal, formula: Sequence[PredictiveScore], smooth: Sequence[PredictiveScore]) -> bool:
    """Whether a formula predicts data left out not worse than the smooth effect, within the scatter of their difference between the parts,
    and comes again in most of the searches without a part. One that does not describes the data it was found in and nothing else.
    """
    worse = np.array([f.chi2 - s.chi2 for f, s in zip(formula, smooth, strict=True)])
    scatter = SCATTERS * float(np.std(worse, ddof=1) * np.sqrt(len(worse))) if len(worse) > 1 else 0.0
    again = proposal.found_in > MOST_SEARCHES * proposal.parts
    return again and float(worse.sum()) <= scatter and proposal.held_out_chi2_dof < proposal.held_out_before_chi2_dof


def refused(proposal: Proposal) -> str:
    """Formulas that were found and are not offered, with the reasons."""
    return (
        f"a formula was sought and none is proposed: the most probable one ({proposal.formula}) predicts data left out with χ²/dof "
        f"{proposal.held_out_chi2_dof:.2f}, the smooth model with {proposal.smooth_chi2_dof:.2f}, and came again in {proposal.found_in} of "
        f"{proposal.parts} searches without a part of the data"
    )


def propose(
    problem: DiagnosisProblem, full: ModelFit, effects: Sequence[EffectFound], progress: Callable[[str], None] = lambda text: None
) -> tuple[tuple[Proposal, ...], tuple[str, ...]]:
    """At most a few formulas for what the unmodelled effects do together, the most probable first, and a sentence on those that were found
    and are not offered: a formula must hold up on data left out.

    One effect that no smooth function describes often takes several smooth ones at several locations: a formula replaces all of them.
    """
    where = located(problem.context, [e for e in effects if e.name == UNKNOWN])
    if not where:
        return (), ()
    progress("searching for formulas of the unmodelled effects")
    here = Setting.of(problem, full)
    space = FormulaSpace.of(here.context, where)
    found = FormulaSearch(here.point, here.others, space).run()
    formulas = different(f for f in found if f.log_posterior > 0)[:PROPOSED]
    if not formulas:
        return (), ("a formula was sought: none of the dictionary is more probable than no formula",)
    progress("searching for formulas without each part of the data")
    again = [FormulaSearch(here.point.restricted(train), here.others, space).to_first_order() for train, _ in here.parts]
    best_again = [{f.shapes for f in different(each)[:PROPOSED]} for each in again]
    before = here.scores()
    smooth = here.scores(None, here.random) if here.random else before
    judged = []
    for formula in formulas:
        scores = here.scores(formula)
        found_in = sum(formula.shapes in each for each in best_again)
        proposal = proposal_of(here, formula, [summed(before), summed(scores), summed(smooth)], found_in, formulas[0].log_posterior)
        judged.append((proposal, holds_up(proposal, scores, smooth)))
    offered = [p for p, good in judged if good]
    if not offered:
        return (), (refused(judged[0][0]),)
    best = max(p.odds for p in offered)
    return tuple(replace(p, odds=float(p.odds / best)) for p in offered), ()


def proposal_of(here: Setting, formula: Formula, scores: Sequence[PredictiveScore], found_in: int, most_probable: float) -> Proposal:
    """scores: on data left out without the formula, with it, and with the smooth model in its place. most_probable: log posterior of the
    formula that the odds are relative to.
    """
    (before, with_it, smooth), term = scores, term_of(here.context, formula)
    return Proposal(
        where=term.where,
        formula=text_of(formula.placed, term.coefficients),
        terms=formula.shapes,
        log_bayes_factor=formula.log_bayes_factor,
        odds=float(np.exp(formula.log_posterior - most_probable)),
        held_out_before_chi2_dof=before.chi2_dof,
        held_out_chi2_dof=with_it.chi2_dof,
        held_out_rms_mm=with_it.rms,
        smooth_chi2_dof=smooth.chi2_dof,
        found_in=found_in,
        parts=len(here.parts),
        term=term,
    )


def located(context: Context, effects: Sequence[EffectFound]) -> list[Location]:
    """Where the unmodelled effects are, where something acts alike (the joint behind a link too, which it can turn as well), and where else
    the evidence does not exclude them. A ball or a station has no covariates of its own.
    """
    known = {location.name: location for location in locations_of_arm(context)}
    if context.scanner_on_flange:
        known["scanner"] = scanner_location()
    found: dict[str, Location] = {}
    for effect in effects:
        other = [w for a in effect.alternatives if a.name == UNKNOWN and (a.odds or 0.0) > DIAGNOSIS.undecided for w in a.where]
        for name in (name for name in (*effect.where, *effect.equivalent, *other) if name in known):
            behind = name if name == "scanner" else context.axes[min(known[name].frame, context.n - 1)]
            found |= {name: known[name], behind: known[behind]}
    return list(found.values())


def text_of(placed: Sequence[PlacedTerm], values: np.ndarray) -> str:
    """Each component that moves, with the sum of its terms: ``A5: 0.0004 sin(q4) sin(q6) rad``. values: (k,) of the coefficients."""
    sums: dict[tuple[str, str], list[str]] = {}
    for (component, text, unit), value in zip((c for p in placed for c in p.coefficients), values, strict=True):
        sums.setdefault((component, unit), []).append(f"{value:+.3g} {text}")
    return "; ".join(f"{component}: {' '.join(terms).removeprefix('+')} {unit}" for (component, unit), terms in sums.items())


def term_of(context: Context, formula: Formula) -> EffectTerm:
    """The formula as the term of an effect. Typical sizes are the fitted ones, rounded; coefficients of one term and unit share one."""
    found, k = formula.hypothesis.solved, len(formula.sigma)
    parts = tuple(described(formula.placed))
    each = [c for p in formula.placed for c in p.coefficients]
    values = found.coefficients[-k:]
    alike = [(j, unit) for j, p in enumerate(formula.placed) for _, _, unit in p.coefficients]
    sizes = {one: np.sqrt(np.mean([v**2 for v, other in zip(values, alike, strict=True) if other == one])) for one in alike}
    return EffectTerm(
        name=NAME,
        where=tuple(dict.fromkeys(p.location.name for p in formula.placed)),
        depends_on=formula.placed[0].term.covariates[0],
        parts=parts,
        names=tuple(f"{part.replace(' ', '.')}.{re.sub(r'[^a-zA-Z0-9]+', '_', text).strip('_')}_{unit}" for part, text, unit in each),
        units=tuple(unit for _, _, unit in each),
        coefficients=values,
        std=np.sqrt(np.maximum(np.diag(found.covariance)[-k:], 0.0)),
        sigma=np.full(k, np.inf),
        typical=np.array([float(f"{sizes[one]:.1g}") for one in alike]),
        ranges=learnt_ranges(context, parts),
    )
