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
from mbcacq.diagnosis.evidence.allowed_names import with_allowed_names
from mbcacq.diagnosis.evidence.evidence_fit import fit_evidence, geometry_of, with_untried_rivals
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.findings import ComparedEffect, ComparedSet, GivenEvidence
from mbcacq.diagnosis.output.evidence_summary import shown, summarized, widened
from mbcacq.diagnosis.output.kept_model import term_of
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import can_be_kept
from mbcacq.effects.effect import Candidate, Parameters
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.effects.support import refusal
from mbcacq.errors import CalibrationError
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.solver import one_thread
from mbcacq.estimation.terms import Term, term
from mbcacq.model.observations import Observations

LEAST_INFORMATION = 1e-6  # of the poses on a coefficient, next to what is given: below, what they state is not a number


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
        here, found = Covariates(obs), best.solved
        terms = [
            term_of(here, m.candidate, m.hyper, found.coefficients[own], found.std[own])
            for m, own in zip(best.members, found.slices(), strict=True)
        ]
        given = self.problem.given
        # They were learnt in a motion, so the poses say nothing of the range in which they hold.
        held = [
            replace(term_of(here, m.candidate, None, given.coefficients[own], given.std[own]), held=True, clamped=())
            for m, own in zip(given.members, given.slices(), strict=True)
        ]
        return EffectModel(obs.cell.robot, (*held, *terms), LearntRecording.of(obs), obs.cell.measurement)


def evidence_given(obs: Observations, stated: Sequence[ComparedEffect], options: CalibrationOptions | None = None) -> PosesGiven | None:
    """The sets of effects that the poses show in addition to those stated elsewhere.

    Parameters
    ----------
    obs : Observations
        The poses.
    stated : sequence of ComparedEffect
        Effects whose parameters are known, in the words of the poses. Those whose coefficients do not follow from their parameters are
        searched as all others.
    options : CalibrationOptions, optional
        Options of the adjustment.

    Returns
    -------
    PosesGiven or None
        None if no stated effect is a candidate of the poses with a single coefficient.

    Raises
    ------
    CalibrationError
        The poses do not determine the cell.
    """
    chosen = options_for(obs, options or CalibrationOptions())
    try:
        with one_thread():
            problem = prepare(obs, chosen)
            given = given_effects(problem, stated)
            return _searched(obs, given, replace(chosen, displaced=as_displaced(problem.linear, given))) if given.members else None
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the poses do not determine the cell with what is given ({error})") from error


def _searched(obs: Observations, given: EffectSet, options: CalibrationOptions) -> PosesGiven:
    problem = with_given(prepare(obs, options), given)
    if problem.in_part:
        problem = problem.searched(problem.linear.keep)
    fit = with_allowed_names(with_untried_rivals(problem, fit_evidence(problem)), problem.context.obs.cell.robot)
    found, hypotheses = summarized(problem, fit), tuple(shown(fit))
    sets = tuple(with_those_given(one, given, h) for one, h in zip(found.sets, hypotheses, strict=True))
    evidence = GivenEvidence(given.labels, replace(found, sets=sets))
    return PosesGiven(problem, evidence, hypotheses)


def with_those_given(one: ComparedSet, given: EffectSet, hypothesis: Hypothesis) -> ComparedSet:
    """A set with the given effects in it, as the poses alone state them beside the others of the set.

    With the prior N(0, 1) and the posterior N(m, v) of a coefficient in its prior's standard deviations, the poses alone state
    N(m / (1 - v), v / (1 - v)).
    """
    mean, covariance = geometry_of(widened(hypothesis))
    k = len(given.coefficients)
    m, v = mean[-k:], np.minimum(np.diag(covariance)[-k:], 1 - LEAST_INFORMATION)
    values, variances = given.coefficients + given.std * m / (1 - v), given.std**2 * v / (1 - v)
    effects = []
    for c, own in ((member.candidate, own) for member, own in zip(given.members, given.slices(), strict=True)):
        here, before = c.parameters(values[own], np.diag(variances[own])), c.parameters(given.coefficients[own], given.covariance[own, own])
        effects.append(ComparedEffect(c.name, c.where, here, prior=before))
    return replace(one, effects=(*effects, *one.effects))


def given_effects(problem: DiagnosisProblem, stated: Sequence[ComparedEffect]) -> EffectSet:
    """The candidates of the poses that are among the stated effects, with the coefficients that follow from the parameters. Effects that an
    arm cannot have are searched as all others."""
    by_label = {one.label: one for one in stated}
    members, mean, std = list[Member](), [np.zeros(0)], [np.zeros(0)]
    for candidate in problem.candidates:
        one = by_label.get(candidate.label)
        known = None if one is None or candidate.variant else coefficient_of(candidate, one.parameters)
        if known is not None and not refusal(candidate, problem.context.obs.cell.robot, known[0], np.diag(known[1] ** 2)):
            members.append(Member(candidate, None))
            mean.append(known[0])
            std.append(known[1])
    return EffectSet(tuple(members), np.concatenate(mean), np.diag(np.concatenate(std) ** 2))


def coefficient_of(candidate: Candidate, parameters: Parameters) -> tuple[np.ndarray, np.ndarray] | None:
    """Mean and standard deviation (1,) of the coefficient of an effect with a single one; None if it does not follow.

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


def as_displaced(linear: LinearProblem, given: EffectSet) -> tuple[tuple[Term, np.ndarray], ...]:
    """Each given effect as a term with its means, both in standard deviations of its coefficients."""
    out = []
    for member, own in zip(given.members, given.slices(), strict=True):
        std = given.std[own]
        parts = [replace(one, basis=one.basis * std) for one in candidate_parts(linear, member.candidate)]
        out.append((term(member.candidate.key, parts, sigma=1.0), given.coefficients[own] / std))
    return tuple(out)


def with_given(problem: DiagnosisProblem, given: EffectSet) -> DiagnosisProblem:
    """The problem with effects in it from the beginning, which are candidates no more."""
    left = [c for c in problem.candidates if c.label not in given.labels]
    return replace(problem, candidates=left, given=given)
