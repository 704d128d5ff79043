"""The evidence of a group of channels as plain data: e-value, compared sets with coefficients and odds, what cannot be told apart."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import RankedSets
from mbcacq.diagnosis.evidence.between_sets import BetweenSets
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import not_separable, reported_hypothesis, undecided
from mbcacq.diagnosis.findings import EvidenceSummary, NotSeparable
from mbcacq.diagnosis.motion.gram_point import GramPoint, cholesky_of
from mbcacq.diagnosis.output.evidence_summary import summary_of
from mbcacq.diagnosis.search.effect_set import EffectSet


def summarized(sets: RankedSets) -> EvidenceSummary:
    """The most probable sets, the empty one among them, with the parameters of each."""
    return summary_of(sets, coefficients)


def pairs_not_separable(sets: RankedSets) -> tuple[NotSeparable, ...]:
    """Sets that the evidence does not exclude in favour of the reported one, effect by effect; those with a further effect beside which a
    reported one is another are among them.
    """
    if not sets.significant:
        return ()
    reported = reported_hypothesis(sets)
    others = [not_separable(reported, other, _likeness(reported, other)) for other in undecided(sets, reported)]
    changing = BetweenSets.of(sets, coefficients).changing()
    further = [not_separable(reported, c.hypothesis, _likeness(reported, c.hypothesis, c.changed), c.changed) for c in changing]
    return (*others, *further)


def _likeness(reported: Hypothesis[GramPoint], other: Hypothesis[GramPoint], changed: frozenset[str] = frozenset()) -> float:
    """Absolute correlation of what the effects explain of which only one of both sets has each, or that both have of other sizes
    (``changed``), beyond offsets and masses.
    """
    keys = [{m.key for m in h.members} for h in (reported, other)]
    moved, members = [], []
    for hypothesis, elsewhere in ((reported, keys[1]), (other, keys[0])):
        found = coefficients(hypothesis)
        own = [(m, p) for m, p in zip(found.members, found.slices(), strict=True) if m.key not in elsewhere or m.label in changed]
        moved.append(np.concatenate([found.coefficients[p] / m.candidate.typical for m, p in own]))
        members += [m for m, _ in own]
    point = reported.point
    A = point.with_effects(point.extended(members)).A
    k = len(moved[0])
    across, squares = moved[0] @ A[:k, k:] @ moved[1], (moved[0] @ A[:k, :k] @ moved[0]) * (moved[1] @ A[k:, k:] @ moved[1])
    return float(min(abs(across) / np.sqrt(max(squares, 1e-300)), 1.0))


def coefficients(hypothesis: Hypothesis[GramPoint]) -> EffectSet:
    """The effects of a set with the posterior of their coefficients, offsets and masses integrated out."""
    members, point = hypothesis.members, hypothesis.point
    if not members:
        return EffectSet(())
    system = point.with_effects(point.extended(members))
    size = np.concatenate([np.full(m.candidate.k, m.size) for m in members])
    typical = np.concatenate([m.candidate.typical for m in members])
    root = np.linalg.inv(cholesky_of(system.A, size**-2.0))
    covariance = root.T @ root
    return EffectSet(members, typical * (covariance @ system.a), covariance * np.outer(typical, typical))
