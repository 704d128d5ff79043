"""Backward elimination: selected effects that are no longer significant are removed."""

from __future__ import annotations

from scipy.special import chdtrc

from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.pose import payload

SIGNIFICANT = 0.001  # own p-value beyond which an effect is not reported, whatever it was found with
LIKELY = 0.05  # the same where there is known to be an effect


def pruned(search: BeamSearch, projected: CandidateScoring, model: EffectSet) -> EffectSet:
    """The set without the effects that are not significant under the noise that was found in the end, removed one by one.

    projected: may have random effects projected out, which can make an effect superfluous that was needed before them.
    """
    model = search.solved(projected, model.effects)
    while model.effects:
        rest = {j: search.solved(projected, model.effects[:j] + model.effects[j + 1 :]) for j in removable(model)}
        dead = [m for j, m in rest.items() if p_value(model, m, j) > required(search, model, m)]
        free = [m for j, m in rest.items() if not search.is_protected(model, j)]
        best = max(
            dead or [m for m in free if m.penalised_gain > model.penalised_gain],
            key=lambda m: m.gain if dead else m.penalised_gain,
            default=None,
        )
        if best is None:
            break
        model = best
    return model


def removable(model: EffectSet) -> list[int]:
    """Numbers of the effects; a wrong payload and the elasticity that shows it stay together."""
    together = (payload.NAME, "joint_compliance") if payload.NAME in model.names else ()
    return [j for j, (c, _) in enumerate(model.effects) if c.name not in together]


def required(search: BeamSearch, model: EffectSet, rest: EffectSet) -> float:
    """p-value that an effect must reach; a mild one if the rest of the set would not be significant without it."""
    carries = rest.effects and model.penalised_gain > search.no_effects.penalised_gain >= rest.penalised_gain
    return LIKELY if search.threshold_reduction or carries else SIGNIFICANT


def p_value(model: EffectSet, rest: EffectSet, j: int) -> float:
    """Of effect j among the others: by the chi2 that is lost without it."""
    return float(chdtrc(model.effects[j][0].k, max(model.gain - rest.gain, 0.0)))
