"""The verdict of the evidence: one bound on false alarms at every size of recording, posterior odds for names and their alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.effect_found import Alternative, EffectFound
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.between_sets import BetweenSets, alternatives_to
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import alternatives_of, reported_hypothesis
from mbcacq.diagnosis.model_fit import Contributions, ModelFit, joint_noise_factor
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect_term import UNKNOWN


def verdict_by_evidence(full: ModelFit, fit: EvidenceFit) -> str:
    """The verdict is ``none`` if the evidence of all effects is below that of noise alone. It is ``cannot_tell`` if the evidence is above
    that and yet shows nothing, if another set is not excluded, or if time ran out before all sets were compared. Otherwise it says which
    explain more of the mismatch: effects of the catalogue, or unmodelled ones. Joints that repeat worse than their data sheet has it are
    a mismatch of their own: the verdict is neither ``none`` nor ``explained`` then.
    """
    noisy = joint_noise_factor(full) > 1.0
    if fit.cut_short:
        return "cannot_tell"
    if not fit.significant and not full.random:
        return "cannot_tell" if fit.undecided or noisy else "none"
    if not fit.significant:
        return "unexplained"
    if alternatives_to(fit, reported_hypothesis(fit)):
        return "cannot_tell"
    if not full.random:
        return "partly_explained" if noisy else "explained"
    contributions = Contributions(full)
    rest = contributions.of(contributions.unmodelled)
    return "partly_explained" if full.model.gain > rest else "unexplained"


def with_alternatives(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects, each with the strongest others that could stand in its place; an unmodelled one of a long recording with the other
    locations of most evidence.
    """
    fit = full.evidence
    reported = reported_hypothesis(fit)
    out = []
    for effect in effects:
        found: dict[str, float] = {}
        for where in effect.where if effect.name != UNKNOWN else effect.where[:1]:
            for label in labels_of(reported, effect.name, where):
                for other, odds in alternatives_of(fit, reported, label).items():
                    found[other] = max(odds, found.get(other, 0.0))
        best = sorted(found.items(), key=lambda item: -item[1])[: OPTIONS.beam]
        ranked = [Alternative.of_label(label, odds) for label, odds in best]
        if full.everywhere and effect.name == UNKNOWN:
            first, *others = full.cells
            odds_of = [(c.location, float(np.exp(c.log_bayes_factor - first.log_bayes_factor))) for c in others[: OPTIONS.beam]]
            ranked = [Alternative(UNKNOWN, (at,), 0.0, odds) for at, odds in odds_of]
        out.append(replace(effect, alternatives=tuple(ranked)))
    return out


def labels_of(reported: Hypothesis, name: str, where: str) -> list[str]:
    """``name:where`` of the effects of this name of which ``where`` is a location."""
    mine = (m for m in reported.members if m.candidate.name == name and where in m.candidate.where)
    return list(dict.fromkeys(m.label for m in mine))


def averaged_over_sets(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects with the parameters as all sets state them that are not excluded."""
    if not full.evidence.significant:
        return list(effects)
    sets = BetweenSets.of(full.evidence)
    reported = reported_hypothesis(full.evidence)
    out = []
    for effect in effects:
        labels = [label for at in effect.where for label in labels_of(reported, effect.name, at)]
        out.append(
            effect if effect.name == UNKNOWN else replace(effect, parameters=sets.averaged(dict.fromkeys(labels), effect.parameters))
        )
    return out
