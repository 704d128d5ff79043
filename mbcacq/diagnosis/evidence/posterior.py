"""Posterior probabilities of sets of effects: which is reported, which others it could be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.options import OPTIONS

PAYLOAD, COMPLIANCE = "payload:", "joint_compliance:"


@dataclass(frozen=True)
class RankedAlternative:
    """Another effect, as ``name:where``, in the place of a reported one. odds: posterior probability relative to the reported set's.

    hypothesis: the set with it.
    """

    label: str
    odds: float
    hypothesis: Hypothesis


def reported_hypothesis(fit: EvidenceFit) -> Hypothesis:
    """The smallest part of the most probable set that is not excluded: a further effect needs odds of twenty to one. So does a wrong
    payload, against the elasticity of the joints through which it shows.
    """
    best = fit.best
    least = best.log_posterior + np.log(OPTIONS.undecided)
    parts = [h for h in fit.hypotheses if h.members and is_part(h, best) and h.log_posterior > least]
    return min(parts, key=lambda h: (with_payload(h), len(h.members), -h.log_posterior), default=best)


def is_part(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether a set is part of another, or has nothing but elastic joints in the place of its payload."""
    if with_payload(one) or not with_payload(other):
        return set(one.key) <= set(other.key)
    return {m.key for m in one.members if not m.label.startswith(COMPLIANCE)} <= set(other.key)


def with_payload(hypothesis: Hypothesis) -> bool:
    return any(m.label.startswith(PAYLOAD) for m in hypothesis.members)


def payload_instead(fit: EvidenceFit, reported: Hypothesis) -> float | None:
    """Odds of the most probable set with a wrong payload against the reported one without, where these do not exclude it."""
    if with_payload(reported):
        return None
    others = [h.log_posterior - reported.log_posterior for h in fit.hypotheses if with_payload(h) and is_part(reported, h)]
    best = max(others, default=-np.inf)
    return float(np.exp(min(best, 0.0))) if best > np.log(OPTIONS.undecided) else None


def alternatives_of(fit: EvidenceFit, reported: Hypothesis, label: str) -> list[RankedAlternative]:
    """What else could stand in the place of a reported effect, most probable first: beside the other reported ones, or beside those of the
    most probable set.
    """
    best: dict[str, RankedAlternative] = {}
    for base in (reported, fit.best):
        rest = base.labels - {label}
        for h in fit.hypotheses:
            others = h.labels - rest
            if label in h.labels or len(others) != 1 or not rest <= h.labels:
                continue
            (name,) = others
            odds = float(np.exp(min(h.log_posterior - base.log_posterior, 0.0)))
            if name not in best or best[name].odds < odds:
                best[name] = RankedAlternative(name, odds, h)
    return sorted(best.values(), key=lambda r: -r.odds)


def undecided(fit: EvidenceFit, reported: Hypothesis) -> list[Hypothesis]:
    """Sets that are neither part nor extension of the reported one, and have more than a twentieth of its probability."""
    least = reported.log_posterior + np.log(OPTIONS.undecided)
    out: dict[frozenset[str], Hypothesis] = {}
    for h in fit.hypotheses:
        if h.members and h.log_posterior > least and not nested(h.labels, reported.labels):
            out.setdefault(h.labels, h)
    return list(out.values())


def nested(one: frozenset[str], other: frozenset[str]) -> bool:
    """Whether one set is part of the other. A wrong payload contains the compliance of every loaded joint."""
    if any(label.startswith(PAYLOAD) for label in one | other):
        one, other = (frozenset(label for label in labels if not label.startswith(COMPLIANCE)) for labels in (one, other))
    return one <= other or one >= other
