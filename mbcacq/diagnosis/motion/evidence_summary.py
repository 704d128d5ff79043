"""The evidence of a group of channels as plain data: e-value, compared sets with coefficients and odds, what cannot be told apart."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import RankedSets
from mbcacq.diagnosis.evidence.coefficients import slices_of
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis, undecided
from mbcacq.diagnosis.motion.gram_point import GramPoint, cholesky_of
from mbcacq.diagnosis.output.evidence_summary import shown
from mbcacq.diagnosis.result import TOGETHER, ComparedEffect, ComparedSet, EvidenceSummary, NotSeparable
from mbcacq.effects.effect import ParameterEstimate, Parameters


def summarized(sets: RankedSets) -> EvidenceSummary:
    """The most probable sets, the empty one among them, with the parameters of each."""
    best = sets.hypotheses[0].log_posterior
    compared = tuple(ComparedSet(_effects_of(sets, h), float(h.log_posterior - best)) for h in shown(sets))
    return EvidenceSummary(0, sets.log_e_value, sets.least, compared)


def pairs_not_separable(sets: RankedSets) -> tuple[NotSeparable, ...]:
    """Sets that the evidence does not exclude in favour of the reported one, effect by effect."""
    if not sets.significant:
        return ()
    reported, out = reported_hypothesis(sets), []
    for other in undecided(sets, reported):
        ours, theirs = reported.labels - other.labels, other.labels - reported.labels
        odds = float(np.exp(min(other.log_posterior - reported.log_posterior, 0.0)))
        out.append(NotSeparable((TOGETHER.join(sorted(ours)), TOGETHER.join(sorted(theirs))), _likeness(reported, other), odds))
    return tuple(out)


def _likeness(reported: Hypothesis[GramPoint], other: Hypothesis[GramPoint]) -> float:
    """Absolute correlation of what the effects explain of which only one of both sets has each, beyond offsets and masses."""
    keys = [{m.key for m in h.members} for h in (reported, other)]
    moved, members = [], []
    for hypothesis, elsewhere in ((reported, keys[1]), (other, keys[0])):
        own = [m for m in hypothesis.members if m.key not in elsewhere]
        mean, _ = _coefficients(hypothesis)
        moved.append(np.concatenate([mean[p] for m, p in zip(hypothesis.members, slices_of(hypothesis.members), strict=True) if m in own]))
        members += own
    point = reported.point
    A = point.with_effects(point.extended(members)).A
    k = len(moved[0])
    across, squares = moved[0] @ A[:k, k:] @ moved[1], (moved[0] @ A[:k, :k] @ moved[0]) * (moved[1] @ A[k:, k:] @ moved[1])
    return float(min(abs(across) / np.sqrt(max(squares, 1e-300)), 1.0))


def _coefficients(hypothesis: Hypothesis[GramPoint]) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean (k,) and covariance (k, k) of all coefficients of a set, in typical sizes."""
    members, point = hypothesis.members, hypothesis.point
    system = point.with_effects(point.extended(members))
    size = np.concatenate([np.full(m.candidate.k, m.size) for m in members])
    root = np.linalg.inv(cholesky_of(system.A, size**-2.0))
    covariance = root.T @ root
    return covariance @ system.a, covariance


def _effects_of(sets: RankedSets, hypothesis: Hypothesis[GramPoint]) -> tuple[ComparedEffect, ...]:
    """The effects of a set with the posterior mean of their parameters, beyond offsets and masses."""
    if not hypothesis.members:
        return ()
    mean, covariance = _coefficients(hypothesis)
    out = []
    for member, own in zip(hypothesis.members, slices_of(hypothesis.members), strict=True):
        candidate, typical = member.candidate.variant.candidate, member.candidate.typical
        scale, before = np.outer(typical, typical), np.diag((member.size * typical) ** 2)

        def reported(c: np.ndarray, v: np.ndarray, of=candidate, hyper=member.candidate.variant.hyper) -> Parameters:
            return of.parameters(c, v, hyper)

        parameters = reported(typical * mean[own], covariance[own, own] * scale)
        with np.errstate(divide="ignore", invalid="ignore"):  # an angle between coefficients that are zero is not a number
            absent, spread = reported(np.zeros(len(typical)), before), reported(typical * mean[own], before)
        prior = {name: ParameterEstimate(absent[name].value, p.std) for name, p in spread.items()}
        log_prior = sets.log_prior_of(member, hypothesis)
        out.append(ComparedEffect(candidate.name, candidate.where, parameters, prior=prior, log_prior=log_prior))
    return tuple(out)
