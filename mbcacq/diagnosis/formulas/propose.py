"""Formulas for the unmodelled effects of a diagnosis: found on all data, scored on data left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import coefficients, prior_sigma
from mbcacq.diagnosis.evidence.hypothesis import UNMODELLED, Member
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.formulas.formula import NAME, PlacedTerm, candidate, described
from mbcacq.diagnosis.formulas.options import OPTIONS
from mbcacq.diagnosis.formulas.search import Formula, FormulaSearch, FormulaSpace
from mbcacq.diagnosis.nonparametric import locations
from mbcacq.diagnosis.nonparametric.locations import SCANNER, Location
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.diagnosis.problem import DiagnosisProblem, thinned, transferred
from mbcacq.diagnosis.result import EffectFound, Proposal
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.folds import split
from mbcacq.diagnosis.validation.predictive_score import NO_CENTRES, PredictiveScore, held_out_score
from mbcacq.effects import unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.effect_term import EffectTerm, learnt_ranges
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import pack


@dataclass(frozen=True)
class Setting:
    """What formulas are sought in, every unmodelled effect taken out.

    point: the noise with everything found in place. others: the parametric effects. linear, noise: by which data left out are scored.
    model, random: the parametric effects, and the unmodelled ones (none where these stand at all locations).
    """

    context: Context
    point: NoisePoint
    others: tuple[Member, ...]
    linear: LinearProblem
    noise: Noise
    model: EffectSet
    random: tuple[RandomEffect, ...]


def propose(
    problem: DiagnosisProblem, full: ModelFit, effects: Sequence[EffectFound], progress: Callable[[str], None] = lambda text: None
) -> tuple[Proposal, ...]:
    """At most a few formulas for what the unmodelled effects do together, the most probable first; none where none predicts data left out.

    One effect that no smooth function describes often takes several smooth ones at several locations: a formula replaces all of them.
    """
    unmodelled = [e for e in effects if e.name == UNMODELLED]
    found = located(problem.context, unmodelled)
    if not found:
        return ()
    progress("searching for formulas of the unmodelled effects")
    here = setting(problem, full)
    spaces = [FormulaSpace.of(here.context, location, on) for location, on in found]
    formulas = [f for f in FormulaSearch(here.point, here.others, spaces).run() if f.log_posterior > OPTIONS.least_log_odds]
    if not formulas:
        return ()
    progress("searching for formulas without each part of the data")
    validation = Validation(here, spaces)
    best = formulas[0].log_posterior
    out = []
    for formula in different(formulas)[: OPTIONS.proposed]:
        score = validation.score(formula)
        if score.chi2 < validation.before.chi2:
            out.append(proposal(here, formula, float(np.exp(formula.log_posterior - best)), validation, score))
    return tuple(out)


def joint_behind(context: Context, name: str) -> str:
    """The joint behind a link or the base, or before the mount; of another location, that location."""
    if name.startswith("link"):
        return f"A{int(name.removeprefix('link')) + 1}"
    return {"base": "A1", "mount": f"A{context.n}"}.get(name, name)


def different(formulas: Sequence[Formula]) -> list[Formula]:
    """The most probable of those of the same functions at the same locations, without those that only add terms to a more probable one."""
    out: dict[frozenset[tuple[str, str]], Formula] = {}
    for formula in formulas:
        functions = frozenset((p.location.name, p.term.shape) for p in formula.placed)
        if not any(other <= functions for other in out):
            out[functions] = formula
    return list(out.values())


def setting(problem: DiagnosisProblem, full: ModelFit) -> Setting:
    """The parametric effects in place, and no unmodelled one. Of a long recording, some of its poses."""
    if full.everywhere:
        small = thinned(problem, full.geometry_only.linear.keep, unmodelled.OPTIONS.many_poses)
        model = transferred(problem, small, full.model)
        others = tuple(Member(c, h) for c, h in model.effects)
        point = NoisePoint(small.linear, problem.prior_noise, pack(full.noise))
        return Setting(small.context, point, others, small.linear, full.noise, model, ())
    best = reported_hypothesis(full.evidence)
    linear = full.geometry_only.linear
    return Setting(problem.context, best.point, best.catalogued, linear, full.noise, full.model, full.random)


def located(context: Context, effects: Sequence[EffectFound]) -> list[tuple[Location, str]]:
    """Where the unmodelled effects are, where something acts alike (the joint behind a link too, which it can turn as well), and where else
    the evidence does not exclude them; with the covariate that was found there. A ball or a station has no covariates of its own.
    """
    on: dict[str, str] = {}
    for effect in effects:
        other = [w for a in effect.alternatives if a.name == UNMODELLED and (a.odds or 0.0) > OPTIONS.odds for w in a.where]
        for name in (*effect.where, *effect.equivalent, *other):
            on.setdefault(name, effect.depends_on)
            on.setdefault(joint_behind(context, name), effect.depends_on)
    arm = {location.name: location for location in locations.of_arm(context)}
    if context.scanner_on_flange:
        arm["scanner"] = SCANNER
    return [(arm[name], covariate) for name, covariate in on.items() if name in arm]


class Validation:
    """The search repeated without each part of the data, and scores of formulas on these parts."""

    def __init__(self, here: Setting, spaces: Sequence[FormulaSpace]):
        self.here = here
        linear, pose = here.linear, here.linear.obs.pose
        fold = split(linear, OPTIONS.folds)[0]
        self.parts = [(linear.keep & (fold != k)[pose], linear.keep & (fold == k)[pose]) for k in range(int(fold.max()) + 1)]
        self.before = self.total(here.model, ())
        self.smooth = self.total(here.model, here.random) if here.random else self.before
        self.found = [
            FormulaSearch(here.point.restricted(train), here.others, spaces).run(final=False)[: OPTIONS.proposed] for train, _ in self.parts
        ]

    def total(self, model: EffectSet, random: Sequence[RandomEffect]) -> PredictiveScore:
        here = self.here
        scores = (held_out_score(here.linear, train, test, model, random, here.noise) for train, test in self.parts)
        return sum(scores, NO_CENTRES)

    def score(self, formula: Formula) -> PredictiveScore:
        """Fitted without each part and evaluated on it."""
        here = self.here
        sigma = sigma_of(formula)
        one = candidate(here.context, formula.placed, sigma / DIAGNOSIS.sizes[-1])
        return self.total(EffectSet((*here.model.effects, (one, None))), ())

    def found_in(self, formula: Formula) -> int:
        """In how many repetitions a formula of the same terms is among the best."""
        return sum(any(shapes(f.placed) == shapes(formula.placed) for f in each) for each in self.found)


def shapes(placed: Sequence[PlacedTerm]) -> frozenset[str]:
    """What a formula is a function of, whatever phase and location."""
    return frozenset(p.term.shape for p in placed)


def sigma_of(formula: Formula) -> np.ndarray:
    """(k,) prior standard deviation of the coefficients, at the most probable size of each term."""
    return np.concatenate([prior_sigma((m,)) for m in own_members(formula)])


def own_members(formula: Formula) -> tuple[Member, ...]:
    return formula.hypothesis.members[-len(formula.placed) :]


def proposal(here: Setting, formula: Formula, odds: float, validation: Validation, score: PredictiveScore) -> Proposal:
    """The formula with its coefficients and scores."""
    found = coefficients(formula.hypothesis)
    own = np.concatenate([np.arange(p.start, p.stop) for p in found.slices[-len(formula.placed) :]])
    values, std = found.mean[own], np.sqrt(np.maximum(np.diag(found.covariance)[own], 0.0))
    return Proposal(
        where=tuple(dict.fromkeys(p.location.name for p in formula.placed)),
        formula=text_of(formula.placed, values),
        terms=tuple(sorted(shapes(formula.placed))),
        log_bayes_factor=formula.log_bayes_factor,
        odds=odds,
        held_out_before_chi2_dof=validation.before.chi2_dof,
        held_out_chi2_dof=score.chi2_dof,
        held_out_rms_mm=score.rms,
        smooth_chi2_dof=validation.smooth.chi2_dof,
        found_in=validation.found_in(formula),
        parts=len(validation.parts),
        term=term_of(here.context, formula, values, std),
    )


def text_of(placed: Sequence[PlacedTerm], values: np.ndarray) -> str:
    """Each component that moves, with the sum of its terms: ``A5: 0.0004 sin(q4) sin(q6) rad``."""
    sums: dict[tuple[str, str], list[str]] = {}
    start = 0
    for one in placed:
        names = one.coefficients
        turns = one.rotates
        for (component, text), value, turn in zip(names, values[start : start + len(names)], turns, strict=True):
            key = (component if component == one.location.name else f"{one.location.name} {component}", "rad" if turn else "mm")
            sums.setdefault(key, []).append(f"{value:+.3g} {text}")
        start += len(names)
    return "; ".join(f"{component}: {' '.join(terms).removeprefix('+')} {unit}" for (component, unit), terms in sums.items())


def term_of(context: Context, formula: Formula, values: np.ndarray, std: np.ndarray) -> EffectTerm:
    """The formula as an effect that is written down; typical sizes are the fitted ones, rounded, alike for all of a term's coefficients
    of one unit.
    """
    parts = tuple(described(formula.placed))
    names, units, typical, start = [], [], [], 0
    for one in formula.placed:
        own, turns = values[start : start + len(one.coefficients)], one.rotates
        for (component, text), turn in zip(one.coefficients, turns, strict=True):
            at = one.location.name if component == one.location.name else f"{one.location.name}.{component}"
            names.append(f"{at}.{plain_name(text)}_{'rad' if turn else 'mm'}")
            units.append("rad" if turn else "mm")
            size = float(np.sqrt(np.mean(own[turns == turn] ** 2)))
            typical.append(float(f"{max(size, 1e-12):.1g}"))
        start += len(one.coefficients)
    first = formula.placed[0]
    where = tuple(dict.fromkeys(p.location.name for p in formula.placed))
    return EffectTerm(
        NAME,
        where,
        first.term.covariates[0],
        parts,
        tuple(names),
        tuple(units),
        values,
        std,
        np.full(len(values), np.inf),
        np.array(typical),
        ranges=learnt_ranges(context, parts),
    )


def plain_name(text: str) -> str:
    """A text of a column as a part of a parameter's name: letters, digits and underscores."""
    short = text.replace("^", "").replace("gravity_torque_", "tau").replace("gravity_moment_", "moment")
    return "_".join("".join(c if c.isalnum() else " " for c in short).split())
