"""Sets of effects in which every name is one that physics allows; what has no such name is unmodelled."""

from __future__ import annotations

from dataclasses import replace

from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.support import joints_without_drive, refusal, refused_in_words, unnamed
from mbcacq.model.cell import RobotModel


def with_allowed_names(fit: EvidenceFit, robot: RobotModel) -> EvidenceFit:
    """The fit with unmodelled effects in the place of names that an arm cannot have, and of those whose reported coefficients are not
    theirs. Location, functions and evidence stay: the search has compared these, whatever they are called.
    """
    refused = refused_names(reported_hypothesis(fit), robot)

    def allowed(m: Member) -> Member:
        if m.candidate.name == UNKNOWN:
            return m
        why = refused.get(m.candidate.key) or joints_without_drive(m.candidate, robot)
        return replace(m, candidate=unnamed(m.candidate, why)) if why else m

    hypotheses = []
    for h in fit.hypotheses:
        members = tuple(map(allowed, h.members))
        hypotheses.append(h if all(a is b for a, b in zip(members, h.members, strict=True)) else replace(h, members=members))
    return replace(fit, hypotheses=tuple(hypotheses))


def refused_names(reported: Hypothesis, robot: RobotModel) -> dict[str, str]:
    """Key of a candidate whose name is refused -> the sentence that says so."""
    if not reported.catalogued:
        return {}
    found, out = reported.solved, dict[str, str]()
    for m, own in zip(found.members, found.slices(), strict=True):
        c, v = found.coefficients[own], found.covariance[own, own]
        why = "" if m.candidate.name == UNKNOWN else refusal(m.candidate, robot, c, v)
        if why:
            out.setdefault(m.candidate.key, refused_in_words(m.candidate, c, v, m.hyper, why))
    return out
