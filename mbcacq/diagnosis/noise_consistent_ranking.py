"""Effects that are close in probability, each ranked under the noise that it leaves itself.

An effect that is not in the model is in the noise: a joint with backlash looks like one that repeats badly. So noise estimated with one
effect in place favours that effect, and noise estimated without any hides a weak one.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np

from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, noise_with
from mbcacq.diagnosis.nonparametric.model_comparison import log_restricted_likelihood
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior

NEAR_MISS = 10.0  # chi2 by which a candidate may miss its threshold under the noise of nothing
TRIED = 3  # candidates that are reconsidered
MAX_DEFICIT = 25.0  # log posterior odds by which an alternative under the noise of another set may be behind


def reconsider_near_misses(search: BeamSearch, linear: LinearProblem, noise: Noise, prior_noise: NoisePrior) -> EffectSet:
    """What missed its threshold by little, under the noise half way between its own and that without it: single effects, and the best set.

    There the gain is the likelihood ratio to second order; under the noise without the effect (a score test) it is too small, under its
    own (Wald) too large.
    """
    projected = CandidateScoring.of(linear, noise)
    best = NO_EFFECTS
    singles = [((s.candidate, s.hyper),) for s in search.expand(projected, NO_EFFECTS, NEAR_MISS)[:TRIED]]
    together = replace(search, threshold_reduction=NEAR_MISS).beam_search(projected).effects
    for effects in [*singles, *([together] if len(together) > 1 else [])]:
        model = search.solve(projected, effects)
        if model is None or model.penalised_gain < -NEAR_MISS:
            continue
        own = noise_with(linear, model, None, noise, prior_noise)
        model = search.solve(CandidateScoring.of(linear, geometric_mean(noise, own)), effects)
        if model is not None and model.penalised_gain > (best.penalised_gain if best.effects else -search.threshold_reduction):
            best = model
    return best


def geometric_mean(a: Noise, b: Noise) -> Noise:
    return Noise(np.sqrt(a.point * b.point), np.sqrt(a.joint * b.joint), float(np.sqrt(a.turn * b.turn)))


def compare_single_exchanges(
    search: BeamSearch, linear: LinearProblem, model: EffectSet, noise: Noise, prior_noise: NoisePrior
) -> tuple[EffectSet, Noise]:
    """The most probable of a set and those that have another candidate in the place of one of its effects, with its noise."""
    projected = CandidateScoring.of(linear, noise)
    best = log_posterior(projected, model, prior_noise), model, noise
    for other in chain.from_iterable(single_exchanges(search, projected, model, j) for j in range(len(model.effects))):
        there, solved = under_own_noise(search, linear, other, noise, prior_noise)
        if solved is not None:
            best = max(best, (log_posterior(there, solved, prior_noise), solved, there.noise), key=lambda each: each[0])
    return best[1:]


def under_own_noise(
    search: BeamSearch, linear: LinearProblem, model: EffectSet, start: Noise, prior_noise: NoisePrior
) -> tuple[CandidateScoring, EffectSet | None]:
    """The problem under the noise that a set leaves, and the set solved there; None where physics forbids that."""
    there = CandidateScoring.of(linear, noise_with(linear, model, None, start, prior_noise))
    return there, search.solve(there, model.effects)


def single_exchanges(search: BeamSearch, projected: CandidateScoring, model: EffectSet, j: int) -> list[EffectSet]:
    """The best sets with another candidate in the place of effect j."""
    rest = search.solve(projected, model.effects[:j] + model.effects[j + 1 :])
    if rest is None or search.is_protected(model, j):
        return []
    out = []
    for scored in search.expand(projected, rest):
        if scored.candidate.key == model.effects[j][0].key or len(out) == TRIED:
            continue
        other = search.solve(projected, (*rest.effects, (scored.candidate, scored.hyper)))
        if other is None or other.penalised_gain <= rest.penalised_gain:
            continue
        if other.log_posterior_odds > model.log_posterior_odds - MAX_DEFICIT:
            out.append(other)
    return out


def log_posterior(projected: CandidateScoring, model: EffectSet, prior_noise: NoisePrior) -> float:
    """Twice the log of the posterior of a set of effects and its noise, up to a constant."""
    likelihood = log_restricted_likelihood(projected, conditioned_on_effects(projected, model), prior_noise)
    return likelihood - (model.gain - model.log_posterior_odds)
