"""The evidence of a fit as plain data: the e-value, and the compared sets with their coefficients and odds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.coupled_effects import couplings_of
from mbcacq.diagnosis.evidence.evidence_fit import stands_for_untried
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import relative_odds, reported_hypothesis, undecided
from mbcacq.diagnosis.findings import ComparedEffect, ComparedSet, EvidenceSummary
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.effects.in_words import odds_in_words

MOST_LOG_ODDS = 300.0  # whose exponential is a number


def summarized(problem: DiagnosisProblem, fit: EvidenceFit) -> EvidenceSummary:
    """The most probable sets of a fit, the empty one among them, with the coefficients of each."""

    def untried(hypothesis: Hypothesis) -> set[str]:
        return {u.candidate.key for u in stands_for_untried(problem, hypothesis)}

    return summary_of(fit, untried, fit.linear.obs.n_poses, tuple(untried_in_words(problem, fit)))


def summary_of(
    sets: EvidenceFit, untried: Callable[[Hypothesis], set[str]] = lambda hypothesis: set(), poses: int = 0, sentences: tuple[str, ...] = ()
) -> EvidenceSummary:
    """The sets that are near the most probable one, and the empty one. untried: keys of the effects in
    it that stand for what was not tried.
    """
    best = sets.hypotheses[0].log_posterior
    each = [widened(h) for h in shown(sets)]
    compared = tuple(ComparedSet(effects_of(sets, h, h.solved, untried(h)), float(h.log_posterior - best)) for h in each)
    return EvidenceSummary(poses, sets.log_e_value, sets.least, compared, sentences)


def shown(sets: EvidenceFit) -> list[Hypothesis]:
    """The sets that are near the most probable one, and the empty one."""
    best = sets.hypotheses[0].log_posterior
    return [h for h in sets.hypotheses if h.log_posterior > best - OPTIONS.reach or not h.members]


def widened(hypothesis: Hypothesis) -> Hypothesis:
    """The set with its coupled effects at their largest sizes, for which their uncertainty was computed (``coupled_effects``).

    Their most probable sizes differ from one recording to the next, and the values of a narrow prior would pass for what was measured.
    """
    coupled = {c.name for c in couplings_of(hypothesis.members)}
    if not coupled:
        return hypothesis
    members = tuple(replace(m, size=max(m.sizes)) if m.candidate.name in coupled else m for m in hypothesis.members)
    return replace(hypothesis, members=members)


def effects_of(sets: EvidenceFit, hypothesis: Hypothesis, solved: EffectSet, untried: set[str]) -> tuple[ComparedEffect, ...]:
    """The effects of a set with their parameters."""
    each = zip(hypothesis.members, solved.slices(), strict=True)
    return tuple(
        compared_effect(sets, hypothesis, m, solved.coefficients[own], solved.covariance[own, own], m.candidate.key not in untried)
        for m, own in each
    )


def compared_effect(sets: EvidenceFit, hypothesis: Hypothesis, member: Member, c: np.ndarray, v: np.ndarray, tried: bool) -> ComparedEffect:
    """An effect of a set, whose coefficients are c (k,) with covariance v (k, k)."""
    candidate, before = member.candidate, np.diag((member.size * member.candidate.typical) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):  # an angle between coefficients that are zero is not a number
        absent, spread = (candidate.parameters(size, before, member.hyper) for size in (np.zeros(candidate.k), c))
    prior = {name: ParameterEstimate(absent[name].value, p.std) for name, p in spread.items() if name in absent}
    log_prior = sets.prior.log_probability(candidate, [m.candidate for m in hypothesis.members if m is not member])
    return ComparedEffect(candidate.name, candidate.where, candidate.parameters(c, v, member.hyper), tried, prior, log_prior)


def untried_in_words(problem: DiagnosisProblem, fit: EvidenceFit) -> list[str]:
    """A sentence about each set that stands for what was not tried and is not excluded, or is the most probable."""
    if not fit.significant:
        return []
    reported, out = reported_hypothesis(fit), dict[str, str]()
    for other in [reported, *undecided(fit, reported)]:
        odds = odds_in_words(relative_odds(other, reported))
        for rival in stands_for_untried(problem, other):
            at = "+".join(rival.candidate.where)
            how = "fits best" if other is reported else f"is not excluded ({odds})"
            out.setdefault(rival.candidate.key, f"{rival.name} at {at} {how}, although it was not tried by name: {rival.reason}")
    return list(out.values())


def e_value_in_words(evidence: EvidenceSummary) -> tuple[str, str]:
    """The odds of effects against none, and whether there is one."""
    odds = odds_in_words(float(np.exp(min(evidence.log_e_value, MOST_LOG_ODDS))))
    return odds, "there is an effect" if evidence.significant else "no effect is shown"
