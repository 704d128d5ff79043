"""The verdict of the evidence: one bound on false alarms at every size of recording, posterior odds for names and their alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.effect_found import Alternative, EffectFound
from mbcacq.diagnosis.evidence.between_sets import BetweenSets, ChangingSet
from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import alternatives_of, not_separable, reported_hypothesis, undecided
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.fitted_model import Contributions, ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.next_measurements import SizedEffect, SizedEffects
from mbcacq.effects.effect_term import UNKNOWN


def verdict_by_evidence(full: ModelFit, fit: EvidenceFit) -> str:
    """The verdict is ``none`` if the evidence of all effects is below that of noise alone. It is ``cannot_tell`` if the evidence is above
    that and yet shows nothing, if another set is not excluded, or if time ran out before all sets were compared. Otherwise it says which
    explain more of the mismatch: effects of the catalogue, or unmodelled ones.
    """
    if fit.cut_short:
        return "cannot_tell"
    if not fit.significant and not full.random:
        return "cannot_tell" if fit.undecided else "none"
    if not fit.significant:
        return "unexplained"
    if alternatives_to(fit, reported_hypothesis(fit)):
        return "cannot_tell"
    if not full.random:
        return "explained"
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
                for other in alternatives_of(fit, reported, label):
                    found[other.label] = max(other.odds, found.get(other.label, 0.0))
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


def pairs_not_separable(fit: EvidenceFit) -> tuple[tuple[NotSeparable, ...], tuple[tuple[SizedEffects, SizedEffects], ...]]:
    """Effects that cannot be told apart from those of the reported set, one by one, and the same pairs with their coefficients."""
    reported = reported_hypothesis(fit)
    entries, pairs = [], []
    changing = {id(c.hypothesis): c.changed for c in changing_sets(fit)}
    for other in alternatives_to(fit, reported):
        changed = changing.get(id(other), frozenset())
        ours, theirs = (reported.labels - other.labels) | changed, (other.labels - reported.labels) | changed
        a, b = sized(reported, ours), sized(other, theirs)
        alike = correlation(displaced(reported, reported, ours), displaced(reported, other, theirs))
        entries.append(not_separable(reported, other, alike, changed))
        if a and b:
            pairs.append((a, b))
    return tuple(entries), tuple(pairs)


def alternatives_to(fit: EvidenceFit, reported: Hypothesis) -> list[Hypothesis]:
    """Sets that the evidence does not exclude in favour of the reported one: others, and those with a further effect beside which a
    reported one is another.

    One that has an unmodelled effect in place of a catalogued one at the same location, with the same displacement, is no other set: it
    describes the same effect in a more general form.
    """
    others = [other for other in undecided(fit, reported) if not _describes_the_same(reported, other)]
    return [*others, *(c.hypothesis for c in changing_sets(fit))]


def changing_sets(fit: EvidenceFit) -> list[ChangingSet]:
    """Sets with further effects that change reported ones beyond their uncertainty; none without an effect."""
    return BetweenSets.of(fit, coefficients).changing() if fit.significant else []


def _describes_the_same(reported: Hypothesis, other: Hypothesis) -> bool:
    ours, theirs = reported.labels - other.labels, other.labels - reported.labels
    places = [{label.partition(":")[2] for label in labels} for labels in (ours, theirs)]
    if places[0] != places[1] or any(label.partition(":")[0] != UNKNOWN for label in theirs):
        return False
    return bool(np.isclose(correlation(displaced(reported, reported, ours), displaced(reported, other, theirs)), 1.0))


def displaced(reported: Hypothesis, hypothesis: Hypothesis, labels: frozenset[str]) -> np.ndarray:
    """(rows,) whitened displacement by some effects of a hypothesis, beyond the geometry, under the noise of the reported set."""
    found, p = coefficients(hypothesis), reported.point.projected
    chosen = [(m, own) for m, own in zip(hypothesis.members, found.slices(), strict=True) if m.label in labels]
    moved = sum((p.block(m.candidate, m.hyper) @ found.coefficients[own] for m, own in chosen), np.zeros(len(p.r0)))
    return moved - p.Q @ (p.Q.T @ moved)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Absolute correlation, 0 where one of them vanishes."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(min(abs(a @ b) / size, 1.0)) if size > 0 else 0.0


def sized(hypothesis: Hypothesis, labels: frozenset[str]) -> SizedEffects:
    """The catalogued effects of these labels with their coefficients."""
    found = coefficients(hypothesis)
    each = zip(hypothesis.members, found.slices(), strict=True)
    chosen = [(m, p) for m, p in each if m.label in labels and m.candidate.name != UNKNOWN]
    return tuple(SizedEffect(m.candidate, m.hyper, found.coefficients[p]) for m, p in chosen)


def averaged_over_sets(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects with the parameters as all sets state them that are not excluded."""
    if not full.evidence.significant:
        return list(effects)
    sets = BetweenSets.of(full.evidence, coefficients)
    reported = reported_hypothesis(full.evidence)
    out = []
    for effect in effects:
        labels = [label for at in effect.where for label in labels_of(reported, effect.name, at)]
        out.append(
            effect if effect.name == UNKNOWN else replace(effect, parameters=sets.averaged(dict.fromkeys(labels), effect.parameters))
        )
    return out
