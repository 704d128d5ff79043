"""Names that are close, each judged under the noise that it leaves itself.

An effect that is not in the model is in the noise: a joint with backlash looks like one that repeats badly. So noise estimated with one
name in place favours that name, and noise estimated without any hides a weak one.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np

from mbcacq.diagnosis.linearized import variance_components
from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric.joint_model import columns_of, with_members
from mbcacq.diagnosis.nonparametric.model_comparison import likelihood
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NOTHING, EffectSet

NEARLY = 10.0  # chi2 that a candidate may lack under the noise of nothing
TRIED = 3  # candidates given a second look
CLOSE = 25.0  # worth by which a rival under the noise of another may be behind


def second_look(search: BeamSearch, linear: LinearProblem, sigma: NoiseEstimate, first: NoiseEstimate) -> EffectSet:
    """What was missed by little, under the noise half way between its own and that without it: single effects, and the best set.

    There the gain is the likelihood ratio to second order; under the noise without the effect (a score test) it is too small, under its
    own (Wald) too large.
    """
    screen = CandidateScoring(linear, sigma)
    best = NOTHING
    nearly = [((s.candidate, s.hyper),) for s in search.expand(screen, NOTHING, NEARLY)[:TRIED]]
    together = replace(search, allowance=NEARLY).grow(screen).members
    for members in [*nearly, *([together] if len(together) > 1 else [])]:
        model = search.solve(screen, members)
        if model is None or model.score < -NEARLY:
            continue
        own = variance_components.estimate(linear, *columns_of(linear, model, None), sigma, first)
        model = search.solve(CandidateScoring(linear, between(sigma, own)), members)
        if model is not None and model.score > (best.score if best.members else -search.allowance):
            best = model
    return best


def between(a: NoiseEstimate, b: NoiseEstimate) -> NoiseEstimate:
    """Geometric mean."""
    return NoiseEstimate(np.sqrt(a.point * b.point), np.sqrt(a.joint * b.joint), float(np.sqrt(a.turn * b.turn)))


def contested(
    search: BeamSearch, linear: LinearProblem, model: EffectSet, sigma: NoiseEstimate, first: NoiseEstimate
) -> tuple[EffectSet, NoiseEstimate]:
    """The most probable of a model and those that have another candidate in the place of one of its members, with its noise."""
    screen = CandidateScoring(linear, sigma)
    best = probability(screen, model, first), model, sigma
    for other in chain.from_iterable(exchanges(search, screen, model, j) for j in range(len(model.members))):
        there, solved = under_own_noise(search, linear, other, sigma, first)
        if solved is not None:
            best = max(best, (probability(there, solved, first), solved, there.noise), key=lambda each: each[0])
    return best[1:]


def under_own_noise(
    search: BeamSearch, linear: LinearProblem, model: EffectSet, start: NoiseEstimate, first: NoiseEstimate
) -> tuple[CandidateScoring, EffectSet | None]:
    """The screen of the noise that a model leaves, and the model solved there; None where physics forbids that."""
    there = CandidateScoring(linear, variance_components.estimate(linear, *columns_of(linear, model, None), start, first))
    return there, search.solve(there, model.members)


def exchanges(search: BeamSearch, screen: CandidateScoring, model: EffectSet, j: int) -> list[EffectSet]:
    """The best models with another candidate in the place of member j."""
    rest = search.solve(screen, model.members[:j] + model.members[j + 1 :])
    if rest is None or search.is_protected(model, j):
        return []
    out = []
    for scored in search.expand(screen, rest):
        if scored.candidate.key == model.members[j][0].key or len(out) == TRIED:
            continue
        other = search.solve(screen, (*rest.members, (scored.candidate, scored.hyper)))
        if other is not None and other.score > rest.score and other.worth > model.worth - CLOSE:
            out.append(other)
    return out


def probability(screen: CandidateScoring, model: EffectSet, first: NoiseEstimate) -> float:
    """Twice the log of the posterior of a set of names and its noise, up to a constant."""
    return likelihood(screen, with_members(screen, model), first) - (model.gain - model.worth)
