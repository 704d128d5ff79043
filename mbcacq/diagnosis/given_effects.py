"""The search in poses when something is known of effects beforehand, as the motion of the same run states it.

An effect that shows only through another one (a tool heavier than declared, through elastic joints) may be out of reach of the poses alone,
which cannot tell how elastic the joints are. The motion can: what it states is the prior of these coefficients, and the search asks what
else there is.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.sufficiency import options_for
from mbcacq.diagnosis.evidence.coefficients import coefficients, geometry_of
from mbcacq.diagnosis.evidence.evidence_fit import fit_evidence, with_untried_rivals
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.findings import ComparedEffect, ComparedSet, GivenEvidence
from mbcacq.diagnosis.output.evidence_summary import shown, summarized, widened
from mbcacq.diagnosis.output.kept_model import term_of
from mbcacq.diagnosis.problem import DiagnosisProblem, GivenEffect, prepare
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import can_be_kept
from mbcacq.effects.effect import Candidate, Parameters, label_of
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.solver import one_thread
from mbcacq.estimation.terms import Term, term
from mbcacq.model.observations import Observations

LEAST_INFORMATION = 1e-6  # of the poses on a coefficient, next to what is given: below, what they state is not a number


@dataclass(frozen=True)
class StatedParameters:
    """A statement about an effect from something else than the poses: its parameters in the words of the poses, value and std by name."""

    name: str
    where: tuple[str, ...]
    parameters: Parameters

    @property
    def label(self) -> str:
        """``name:where``."""
        return label_of(self.name, self.where)


@dataclass(frozen=True, eq=False)
class PosesGiven:
    """The poses searched with what something else states. given: the effects that it states; hypotheses: the sets of ``evidence``."""

    problem: DiagnosisProblem
    evidence: GivenEvidence
    hypotheses: tuple[Hypothesis, ...]

    def model(self, labels: Collection[str]) -> EffectModel | None:
        """The effects of the set that has those of these labels which the poses were searched for; those that were given are held. None
        where there is no such set, or where it has an effect that is not written down.
        """
        part, sets = self.evidence.evidence.part_of(labels), self.evidence.evidence.sets
        best = next((h for one, h in zip(sets, self.hypotheses, strict=True) if one is part), None)
        if best is None or not all(can_be_kept(m.candidate, m.hyper) for m in best.members):
            return None
        obs = self.problem.linear.obs
        here, found = Covariates(obs), coefficients(best)
        terms = [
            term_of(here, m.candidate, m.hyper, found.coefficients[own], np.sqrt(np.diag(found.covariance)[own]))
            for m, own in zip(best.members, found.slices(), strict=True)
        ]
        # They were learnt in a motion, so the poses say nothing of the range in which they hold.
        held = [replace(term_of(here, g.candidate, None, g.mean, g.std), held=True, clamped=()) for g in self.problem.given]
        return EffectModel(obs.cell.robot, (*held, *terms), LearntRecording.of(obs), obs.cell.measurement)


def evidence_given(obs: Observations, stated: Sequence[StatedParameters], options: CalibrationOptions | None = None) -> PosesGiven | None:
    """The sets of effects that the poses show beside those that something else states.

    Parameters
    ----------
    obs : Observations
        The poses.
    stated : sequence of StatedParameters
        Effects whose parameters are known. Those whose coefficients do not follow from their parameters are searched as all others.
    options : CalibrationOptions, optional
        Options of the adjustment.

    Returns
    -------
    PosesGiven or None
        None where no stated effect is a candidate of the poses with a single coefficient.

    Raises
    ------
    CalibrationError
        The poses do not determine the cell.
    """
    chosen = options_for(obs, options or CalibrationOptions())
    try:
        with one_thread():
            given = given_effects(prepare(obs, chosen), stated)
            return _searched(obs, given, chosen) if given else None
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the poses do not determine the cell with what is given ({error})") from error


def _searched(obs: Observations, given: Sequence[GivenEffect], options: CalibrationOptions) -> PosesGiven:
    problem = with_given(prepare(obs, replace(options, displaced=tuple(map(as_displaced, given)))), given)
    if problem.in_part:
        problem = problem.searched(problem.linear.keep)
    fit = with_untried_rivals(problem, fit_evidence(problem))
    found, hypotheses = summarized(problem, fit), tuple(shown(fit))
    sets = tuple(with_those_given(one, given, h) for one, h in zip(found.sets, hypotheses, strict=True))
    evidence = GivenEvidence(tuple(g.candidate.label for g in given), replace(found, sets=sets))
    return PosesGiven(problem, evidence, hypotheses)


def with_those_given(one: ComparedSet, given: Sequence[GivenEffect], hypothesis: Hypothesis) -> ComparedSet:
    """A set with the given effects in it, as the poses alone state them beside the others of the set.

    With the prior N(0, 1) and the posterior N(m, v) of a coefficient in its prior's standard deviations, the poses alone state
    N(m / (1 - v), v / (1 - v)).
    """
    mean, covariance = geometry_of(widened(hypothesis))
    m, v = mean[-len(given) :], np.minimum(np.diag(covariance)[-len(given) :], 1 - LEAST_INFORMATION)
    effects = []
    for g, centre, spread in zip(given, m / (1 - v), v / (1 - v), strict=True):
        own = g.candidate.parameters(g.mean + g.std * centre, np.diag(g.std**2 * spread))
        before = g.candidate.parameters(g.mean, np.diag(g.std**2))
        effects.append(ComparedEffect(g.candidate.name, g.candidate.where, own, prior=before))
    return replace(one, effects=(*effects, *one.effects))


def given_effects(problem: DiagnosisProblem, stated: Sequence[StatedParameters]) -> tuple[GivenEffect, ...]:
    """The candidates of the poses that are among the stated effects, with the coefficients that follow from the parameters."""
    by_label = {one.label: one for one in stated}
    found = []
    for candidate in problem.candidates:
        one = by_label.get(candidate.label)
        known = None if one is None or candidate.variant else coefficient_of(candidate, one.parameters)
        if known is not None:
            parts = tuple(candidate_parts(problem.linear, candidate))
            found.append(GivenEffect(candidate=candidate, parts=parts, mean=known[0], std=known[1]))
    return tuple(found)


def coefficient_of(candidate: Candidate, parameters: Parameters) -> tuple[np.ndarray, np.ndarray] | None:
    """Mean and standard deviation (1,) of the coefficient of an effect with a single one; None where it does not follow.

    The parameter must be in proportion to the coefficient, sign included: a width does not tell on which side of its motion a joint is.
    """
    if candidate.k != 1 or candidate.hyper is not None:
        return None
    unit, opposite = (candidate.parameters(np.full(1, sign), np.eye(1)) for sign in (1.0, -1.0))
    if len(unit) != 1 or not set(unit) <= set(parameters):
        return None
    ((name, per_unit),) = unit.items()
    of_one, of_other = (np.array(p.components[0]) for p in (per_unit, opposite[name]))
    mean, std = map(np.array, parameters[name].components)
    if len(mean) != 1 or len(of_one) != 1 or not of_one[0] or of_other[0] != -of_one[0]:
        return None
    return (mean / of_one, std / np.abs(of_one)) if np.isfinite(mean[0]) and std[0] > 0 else None


def as_displaced(given: GivenEffect) -> tuple[Term, np.ndarray]:
    """A given effect as a term with its means, both in standard deviations of its coefficients."""
    parts = [replace(one, basis=one.basis * given.std) for one in given.parts]
    return term(given.candidate.key, parts, sigma=1.0), given.mean / given.std


def with_given(problem: DiagnosisProblem, given: Sequence[GivenEffect]) -> DiagnosisProblem:
    """The problem with effects in it from the beginning, which are candidates no more."""
    labels = {(g.candidate.name, g.candidate.where) for g in given}
    left = [c for c in problem.candidates if (c.name, c.where) not in labels]
    return replace(problem, candidates=left, given=tuple(given))
