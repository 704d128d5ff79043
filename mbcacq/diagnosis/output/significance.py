"""Probabilities of the reported effects, corrected for all that was tried, and locations that these data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import TOGETHER, EffectFound, MismatchEntry, NotSeparable
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.model.observations import Observations


def with_significance(effects: Sequence[EffectFound], setup: DiagnosisProblem, full: ModelFit) -> list[EffectFound]:
    """The effects with p_local and p_corrected (Sidak, over all candidates and the independent values of their hyper-parameters), or
    with their Bayes factor, corrected for the number of locations.
    """
    tried = sum(c.hyper.independent if c.hyper is not None else 1.0 for c in setup.candidates)
    evidence: dict[str, float] = {}
    for cell in full.cells:
        evidence[cell.location] = max(evidence.get(cell.location, -np.inf), float(cell.log_bayes_factor))
    out = []
    for effect in effects:
        if effect.name != UNKNOWN:
            corrected = float(-np.expm1(tried * np.log1p(-min(effect.p_value, 1 - 1e-16))))
            out.append(replace(effect, p_local=effect.p_value, p_corrected=corrected))
            continue
        log = evidence.get(effect.where[0])
        corrected = None if log is None else float(min(1.0, len(evidence) * np.exp(-min(log, 700.0))))
        out.append(replace(effect, p_corrected=corrected, log_bayes_factor=log))
    return out


def classes(obs: Observations, not_separable: Sequence[NotSeparable]) -> list[tuple[str, ...]]:
    """Locations that move the measured centres alike.

    With one station the base is the station: moving either is moving the other back. Further classes are the places of one effect
    that the diagnosis could not tell apart.
    """
    used = np.unique(obs.station)
    out: list[set[str]] = [{"base", f"station{obs.cell.stations[used[0]].id}"}] if len(used) == 1 else []
    for pair in not_separable:
        split = [label.split(":", 1) for label in pair.effects]
        alone = not any(TOGETHER in label for label in pair.effects)  # several effects in the place of one are at no one location
        if alone and all(len(s) == 2 for s in split) and split[0][0] == split[1][0]:
            out.append({place for _, where in split for place in where.split("+")})
    merged: list[set[str]] = []
    for one in out:
        for other in [m for m in merged if m & one]:
            one = one | other
            merged.remove(other)
        merged.append(one)
    return [tuple(sorted(m)) for m in merged]


def with_classes(
    effects: Sequence[EffectFound], mismatch: Sequence[MismatchEntry], found: Sequence[tuple[str, ...]]
) -> tuple[list[EffectFound], list[MismatchEntry]]:
    """Effects and mismatch with the locations that are equivalent to theirs."""

    def others(places: Sequence[str]) -> tuple[str, ...]:
        return tuple(sorted({o for c in found if set(places) & set(c) for o in c} - set(places)))

    return [replace(e, equivalent=others(e.where)) for e in effects], [replace(m, equivalent=others((m.at,))) for m in mismatch]
