"""Sets with an effect that was not tried in the place of one that was: a confident name must be better than these too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior, estimated
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.untried import UntriedEffect, untried


def with_untried_rivals(problem: DiagnosisProblem, fit: EvidenceFit) -> EvidenceFit:
    """The fit with sets in which what was not tried stands in the place of every effect at its location, as probable beforehand as the
    effect of the catalogue that it stands for.
    """
    if not fit.significant:
        return fit
    rivals = untried(problem.context, problem.candidates)
    locations = len(problem.design_blocks.locations)
    prior, known = (
        SetPrior.of(problem.candidates, locations, [g.candidate.label for g in problem.given]),
        {h.key: h for h in fit.hypotheses},
    )
    for base in {h.key: h for h in (fit.best, reported_hypothesis(fit))}.values():
        for rival in rivals:
            instead = replaced(base, rival, prior)
            if instead is not None:
                known.setdefault(instead.key, instead)
    return replace(fit, hypotheses=tuple(sorted(known.values(), key=lambda h: -h.log_posterior)))


def replaced(base: Hypothesis, rival: UntriedEffect, prior: SetPrior) -> Hypothesis | None:
    """The set with the rival in the place of all that it has at that location; None where it has nothing there, or nothing but what the
    rival stands for or is.
    """
    rest = tuple(m for m in base.members if m.candidate.where != rival.candidate.where)
    here = {m.candidate.name for m in base.members if m.candidate.where == rival.candidate.where}
    if here <= {rival.name, UNKNOWN}:
        return None
    return estimated((*rest, Member(rival.candidate, None)), base.point, log_prior(rest, rival, prior))


def log_prior(rest: Sequence[Member], rival: UntriedEffect, prior: SetPrior) -> float:
    """Log posterior of the set with the effect that the rival stands for."""
    named = replace(rival.candidate, name=rival.name)
    return prior.log_probability_of_set([*(m.candidate for m in rest), named])


def stands_for_untried(problem: DiagnosisProblem, hypothesis: Hypothesis) -> list[UntriedEffect]:
    """The effects of a set that stand for what was not tried."""
    known = {rival.candidate.key: rival for rival in untried(problem.context, problem.candidates)}
    return [known[m.candidate.key] for m in hypothesis.members if m.candidate.name == UNKNOWN and m.candidate.key in known]
