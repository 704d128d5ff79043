"""The evidence of a fit as plain data: the e-value, and the compared sets with their coefficients and odds."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import RankedSets
from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis, undecided
from mbcacq.diagnosis.evidence.untried_rivals import stands_for_untried
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import TOGETHER, ComparedEffect, ComparedSet, EvidenceSummary
from mbcacq.effects.effect import ParameterEstimate, parameter_in_words
from mbcacq.effects.in_words import effect_in_words, odds_in_words

MOST_SETS = 6  # that the text shows
MOST_LOG_ODDS = 300.0  # whose exponential is a number


def summarized(problem: DiagnosisProblem, fit: EvidenceFit) -> EvidenceSummary:
    """The most probable sets of a fit, the empty one among them, with the coefficients of each."""
    best = fit.hypotheses[0].log_posterior
    sets = tuple(ComparedSet(effects_of(problem, fit, h), float(h.log_posterior - best)) for h in shown(fit))
    return EvidenceSummary(fit.linear.obs.n_poses, fit.log_e_value, fit.least, sets, tuple(untried_in_words(problem, fit)))


def shown(sets: RankedSets) -> list[Hypothesis]:
    """The sets that are near the most probable one, and the empty one."""
    best = sets.hypotheses[0].log_posterior
    return [h for h in sets.hypotheses if h.log_posterior > best - OPTIONS.reach or not h.members]


def effects_of(problem: DiagnosisProblem, fit: EvidenceFit, hypothesis: Hypothesis) -> tuple[ComparedEffect, ...]:
    """The effects of a set with their parameters."""
    found, untried = coefficients(hypothesis), {u.candidate.key for u in stands_for_untried(problem, hypothesis)}
    out = []
    for member, own in zip(hypothesis.members, found.slices, strict=True):
        candidate = member.candidate
        reported = candidate.parameters(found.mean[own], found.covariance[own, own], member.hyper)
        parameters = {name: ParameterEstimate(p.value, p.std) for name, p in reported.items()}
        before = np.diag((member.size * candidate.typical) ** 2)
        absent, spread = (candidate.parameters(c, before, member.hyper) for c in (np.zeros(candidate.k), found.mean[own]))
        prior = {name: ParameterEstimate(absent[name].value, p.std) for name, p in spread.items() if name in absent}
        tried, log_prior = candidate.key not in untried, fit.log_prior_of(member, hypothesis)
        out.append(ComparedEffect(candidate.name, candidate.where, parameters, tried, prior, log_prior))
    return tuple(out)


def untried_in_words(problem: DiagnosisProblem, fit: EvidenceFit) -> list[str]:
    """A sentence about each set that stands for what was not tried and is not excluded, or is the most probable."""
    if not fit.significant:
        return []
    reported, out = reported_hypothesis(fit), dict[str, str]()
    for other in [reported, *undecided(fit, reported)]:
        odds = odds_in_words(float(np.exp(min(other.log_posterior - reported.log_posterior, 0.0))))
        for rival in stands_for_untried(problem, other):
            at = "+".join(rival.candidate.where)
            how = "is what fits best" if other is reported else f"is not excluded ({odds})"
            out.setdefault(rival.candidate.key, f"{rival.name} at {at} {how}, although it was not tried by name: {rival.reason}")
    return list(out.values())


def evidence_in_words(evidence: EvidenceSummary) -> str:
    """The e-value and the most probable sets as text of several lines."""
    least = float(np.exp(evidence.least_log_e_value))
    found = "there is an effect" if evidence.significant else "no effect is shown"
    odds = odds_in_words(float(np.exp(min(evidence.log_e_value, MOST_LOG_ODDS))))
    lines = [f"{evidence.poses} poses: effects against none {odds} (an effect is reported from {least:.0f} : 1 on): {found}."]
    for one in evidence.sets[:MOST_SETS]:
        named = TOGETHER.join(effect_in_words(f"{e.name}:{'+'.join(e.where)}") for e in one.effects) or "no effect"
        values = "; ".join(parameter_in_words(name, p) for e in one.effects for name, p in e.parameters.items())
        lines.append(f"  {odds_in_words(float(np.exp(one.log_odds))):<24} {named}{f': {values}' if values else ''}")
    return "\n".join([*lines, *(f"Note: {sentence}." for sentence in evidence.untried)])
