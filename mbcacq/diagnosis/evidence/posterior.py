"""Posterior probabilities of sets of effects: which is reported, which others it could be."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.coupled_effects import couplings_of
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.findings import TOGETHER, NotSeparable
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.declaration import EffectCoupling

MOST_LOG_ODDS = 30.0  # larger ones are no more certain, and would overflow


def reported_hypothesis(fit: EvidenceFit) -> Hypothesis:
    """The smallest subset of the most probable set whose posterior odds against that set exceed 1 : 20. An effect that shows only through
    another one needs the same odds against sets with that other one alone.
    """
    best = fit.best
    least = best.log_posterior + np.log(OPTIONS.undecided)
    parts = [h for h in fit.hypotheses if h.members and is_part(h, best) and h.log_posterior > least]
    return min(parts, key=lambda h: (is_coupled(h), len(h.members), -h.log_posterior), default=best)


def is_part(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether a set is part of another, or differs by nothing but more of the effects through which the coupled effects of the other
    show.
    """
    if is_coupled(one) or not is_coupled(other):
        return set(one.key) <= set(other.key)
    through = {c.through for c in couplings_of(other.members)}
    return {m.key for m in one.members if m.candidate.name not in through} <= set(other.key)


def is_coupled(hypothesis: Hypothesis) -> bool:
    """Whether a set has an effect that shows only through another one."""
    return bool(couplings_of(hypothesis.members))


def coupled_instead(fit: EvidenceFit, reported: Hypothesis) -> list[tuple[EffectCoupling, float]]:
    """Effects that show only through another one and that the reported set, which has none, does not exclude: their couplings, with the
    odds of the most probable set that has one.
    """
    if is_coupled(reported):
        return []
    best: dict[str, tuple[EffectCoupling, float]] = {}
    for h in fit.hypotheses:
        odds = relative_odds(h, reported)
        if odds > OPTIONS.undecided and is_coupled(h) and is_part(reported, h):
            for c in couplings_of(h.members):
                best[c.name] = max((c, odds), best.get(c.name, (c, 0.0)), key=lambda one: one[1])
    return list(best.values())


def alternatives_of(fit: EvidenceFit, reported: Hypothesis, label: str) -> dict[str, float]:
    """What else (``name:where``) could stand in the place of a reported effect, with its odds relative to the reported set, most probable
    first: beside the other reported ones, or beside those of the most probable set.
    """
    best: dict[str, float] = {}
    for base in (reported, fit.best):
        rest = base.labels - {label}
        for h in fit.hypotheses:
            others = h.labels - rest
            if label in h.labels or len(others) != 1 or not rest <= h.labels:
                continue
            (name,) = others
            best[name] = max(relative_odds(h, base), best.get(name, 0.0))
    return dict(sorted(best.items(), key=lambda one: -one[1]))


def undecided(fit: EvidenceFit, reported: Hypothesis) -> list[Hypothesis]:
    """Sets that are neither part nor extension of the reported one, and have more than a twentieth of its probability."""
    least = reported.log_posterior + np.log(OPTIONS.undecided)
    out: dict[frozenset[str], Hypothesis] = {}
    for h in fit.hypotheses:
        if h.members and h.log_posterior > least and not nested(h, reported):
            out.setdefault(h.labels, h)
    return list(out.values())


def not_separable(reported: Hypothesis, other: Hypothesis, correlation: float, changed: frozenset[str] = frozenset()) -> NotSeparable:
    """The effects that only one of two sets has. correlation: of what these explain; changed: effects of both sets, of different sizes."""
    ours, theirs = (reported.labels - other.labels) | changed, (other.labels - reported.labels) | changed
    sides = TOGETHER.join(sorted(ours)), TOGETHER.join(sorted(theirs))
    return NotSeparable(sides, correlation, relative_odds(other, reported))


def relative_odds(one: Hypothesis, other: Hypothesis) -> float:
    """Posterior probability of a set relative to another. It is above one where the other is reported because it has fewer effects, and
    these are not excluded.
    """
    return float(np.exp(min(one.log_posterior - other.log_posterior, MOST_LOG_ODDS)))


def nested(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether one set is part of the other. A coupled effect contains the other effect at every location at which that matters."""
    through = {c.through for c in couplings_of((*one.members, *other.members))}
    a, b = (frozenset(m.label for m in h.members if m.candidate.name not in through) for h in (one, other))
    return a <= b or a >= b
