"""Tables of the diagnosis: the parametric effects with their parameters, the unmodelled ones, and the mismatch by location.

Each has its probability, corrected for all that was tried, and the locations that these data cannot tell apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry
from mbcacq.diagnosis.findings import TOGETHER, NotSeparable
from mbcacq.diagnosis.model_fit import Contributions, ModelFit
from mbcacq.diagnosis.nonparametric.joint_model import coefficients_of
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.bayes_factor import prior_weight
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.found_again import Repetitions, group_label
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.effects import catalogue
from mbcacq.effects.effect import BREAKPOINT, JOINTS, ParameterEstimate, Parameters, joined_parameters, label_of
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.estimation.random_effect_sizes import joined
from mbcacq.model.observations import Observations
from mbcacq.quantities import K

ONE_ENTRY = (*JOINTS, "link", "station")  # locations of which several make one entry of an effect
STEP = 0.02  # relative, of the derivative by a breakpoint: over a few poses at least
MOST_GROUPS = 12  # whose sizes are stated
SMALLEST_P = float(np.finfo(float).tiny)  # no probability is reported as zero


Ranked = tuple[bool, float, EffectFound]  # whether it stands in front, chi2 that it explains beyond all others, the effect


def effects_by_contribution(full: ModelFit, shares: Contributions, validation: CrossValidation, again: Repetitions) -> list[EffectFound]:
    """All effects, named and unmodelled, those first that explain most of what the others cannot. An effect that shows only through another
    one (a wrong payload through elastic joints) stands in front of all others. again: whether parts of the recording show each of them.
    """
    ranked = parametric_effects(full, shares, validation, again) + unmodelled_effects(full, shares, validation, again)
    return [effect for *_, effect in sorted(ranked, key=lambda item: (-item[0], -item[1]))]


def parametric_effects(full: ModelFit, contributions: Contributions, validation: CrossValidation, again: Repetitions) -> list[Ranked]:
    """The effects gathered by name: several joints of one effect make one entry, those where halves do not both show it another one."""
    model = full.model
    grouped: dict[tuple[str, bool], list[int]] = {}
    for j, m in enumerate(model.members):
        name = m.candidate.name
        several = m.candidate.where[0].startswith(ONE_ENTRY) and not catalogue.declaration(name).between_locations
        repeats = m.label not in again or again[m.label].repeats
        grouped.setdefault((name if several else m.label, repeats), []).append(j)
    out = list[Ranked]()
    for members in grouped.values():
        first = model.members[members[0]].candidate
        gain = contributions.of(members)
        effect = EffectFound(
            name=first.name,
            where=tuple(dict.fromkeys(w for j in members for w in model.members[j].candidate.where)),
            parameters=merged_parameters(full, members),
            p_value=likelihood_ratio_p(full, members, gain),
            held_out_gain=(removed := gain_left_out(validation, model, members)),
            held_out_gain_std=validation.gain_std(removed),
            depends_on=first.depends_on,
            found_again=tuple(again[label] for label in dict.fromkeys(model.members[j].label for j in members) if label in again),
        )
        out.append((catalogue.declaration(first.name).coupling is not None, gain, effect))
    return out


def gain_left_out(validation: CrossValidation, model: EffectSet, members: list[int]) -> float:
    """Share of the held-out excess that an entry removes: an effect with entries at several locations has the entry at its own."""
    name = model.members[members[0]].candidate.name
    if sum(m.candidate.name == name for m in model.members) == len(members):
        return validation.gain(name)
    return min(sum(validation.gain(label) for label in {model.members[j].label for j in members}), 1.0)


def likelihood_ratio_p(full: ModelFit, members: list[int], gain: float) -> float:
    """The probability that noise alone gains as much chi2 with as many coefficients as these effects have."""
    return max(float(chdtrc(sum(full.model.members[j].candidate.k for j in members), max(gain, 0.0))), SMALLEST_P)


def merged_parameters(full: ModelFit, members: list[int]) -> dict[str, ParameterEstimate]:
    """Parameters of these effects; a name that occurs several times (several orders at one joint) gets a tuple of values."""
    model = full.model
    out = joined_parameters(model.members[j].candidate.parameters(*full.stated(j), model.members[j].hyper) for j in members)
    found = (model.members[j].candidate for j in members)
    for name, joint in dict.fromkeys((c.name, c.where[0]) for c in found if catalogue.declaration(c.name).refines is not None):
        out |= parameters_of_branches(full, name, joint)
    return out


def parameters_of_branches(full: ModelFit, name: str, at: str) -> Parameters:
    """Parameters of an effect that is a further branch of another one, together with that one: K1, K2 .. of a gearbox, say. None where
    the other one was not found at the location.
    """
    refinement = catalogue.declaration(name).refines
    assert refinement is not None, "only asked of an effect that refines another one"
    model, slices = full.model, full.model.slices()
    each = zip(model.members, slices, strict=True)
    here = [(m.candidate.name, m.hyper, own.start) for m, own in each if m.candidate.where == (at,)]
    last = [row for other, _, row in here if other == refinement.of]
    further = sorted((float(breakpoint), row) for other, breakpoint, row in here if other == name and breakpoint)
    if not last or not further:
        return {}
    rows = [last[0], *(row for _, row in further)]
    scale = np.array([1.0, *(refinement.excess(breakpoint) for breakpoint, _ in further)])
    covariance = covariance_with_free_breakpoints(full)[np.ix_(rows, rows)] * np.outer(scale, scale)
    return refinement.report(at, model.coefficients[rows] * scale, covariance)


def covariance_with_free_breakpoints(full: ModelFit) -> np.ndarray:
    """(k, k) of the coefficients, with the breakpoints of all effects unknown as well (to first order)."""
    model, projected = full.model, full.geometry_only
    blocks = [projected.block(m.candidate, m.hyper) for m in model.members]
    for m, own in zip(model.members, model.slices(), strict=True):
        c, at = m.candidate, m.hyper
        if c.hyper is not None and c.hyper.kind == BREAKPOINT and at:
            turned = projected.block(c, (1 + STEP) * at) - projected.block(c, (1 - STEP) * at)
            blocks.append(turned @ model.coefficients[own][:, None] / (2 * STEP))
    X, k = np.concatenate(blocks, axis=1), len(model.coefficients)
    absorbed = projected.Q.T @ X
    S = X.T @ X - absorbed.T @ absorbed
    S[:k, :k] += np.diag(np.concatenate([prior_weight(m.candidate) for m in model.members]))
    size = 1 / np.sqrt(np.diag(S))
    return (np.linalg.inv(S * np.outer(size, size) + 1e-12 * np.eye(len(S))) * np.outer(size, size))[:k, :k]


def unmodelled_effects(full: ModelFit, contributions: Contributions, validation: CrossValidation, again: Repetitions) -> list[Ranked]:
    """One entry for each location of the unmodelled effects. In a long recording they act at all locations: there is one entry then, at the
    location of the largest evidence, with the sizes that are beyond their expanded uncertainty and that halves both show.
    """
    if not full.random:
        return []
    spread = {label: one.size_spread for label, one in again.items()}
    size = {key: (rms, max(std, spread.get(group_label(*key), 0.0) * rms)) for key, (rms, std) in displacements(full).items()}
    ranked = sorted(size, key=lambda key: -size[key][0])
    out = list[Ranked]()

    def entry(at: str, on: str, stated: list[tuple[str, str]], log_bayes_factor: float, gain: float, columns: list[int]) -> None:
        effect = EffectFound(
            name=UNKNOWN,
            where=(at,),
            parameters={f"{at}({on}).rms_mm": ParameterEstimate(*size[at, on]) for at, on in stated},
            p_value=_bayes_p(log_bayes_factor),
            held_out_gain=gain,
            held_out_gain_std=validation.gain_std(gain),
            depends_on=on,
            found_again=tuple(again[label] for label in [label_of(UNKNOWN, (at,))] if label in again),
        )
        out.append((False, contributions.of(columns), effect))

    if full.everywhere:
        first = full.cells[0]
        stated = [key for key in ranked if size[key][0] > K * size[key][1]] or ranked[:1]
        gain, columns = validation.unmodelled_gain, contributions.unmodelled
        entry(first.location, first.depends_on, stated[:MOST_GROUPS], first.log_bayes_factor, gain, columns)
        return out
    for at in dict.fromkeys(at for at, _ in ranked):
        mine = [key for key in ranked if key[0] == at]
        evidence = max((c.log_bayes_factor for c in full.cells if c.location == at), default=0.0)
        entry(at, mine[0][1], mine, evidence, validation.gain(f"{UNKNOWN}:{at}"), contributions.groups_at(full, at))
    return out


def _bayes_p(log_bayes_factor: float) -> float:
    """Upper limit of the p-value of a Bayes factor, given by its natural logarithm."""
    return max(float(np.exp(-max(log_bayes_factor, 0.0))), SMALLEST_P)


def displacements(full: ModelFit) -> dict[tuple[str, str], tuple[float, float]]:
    """(location, covariate) -> how much of what the unmodelled effects there do neither geometry nor named effects compensate: 3D rms
    (mm) of the kept centres, and its standard deviation.

    It is at most what these leave of the misfit: beyond that, unmodelled effects compensate each other.
    """
    (coefficients, covariance), linear = full.random_effects, full.geometry_only.linear
    named = full.without_random_effects().joint
    misfit = rms_of(named.left_of(linear.residual)[linear.keep, :3])
    index: dict[tuple[str, str], list[int]] = {}
    for g, group in enumerate(full.random):
        index.setdefault((group.location, group.depends_on), []).append(g)
    out, slices = {}, coefficients_of(full.random)
    for key, chosen in index.items():
        mine = joined([slices[g] for g in chosen])
        parts = [full.random[g].parts for g in chosen]
        each = (linear.displacement(p, coefficients[slices[g]]) for g, p in zip(chosen, parts, strict=True))
        moved = named.left_of(sum(each, np.zeros_like(linear.residual)))
        moved[~linear.keep], moved[:, 3:] = 0.0, 0.0
        size = rms_of(moved[linear.keep, :3])
        slope = np.concatenate(named.slopes(parts, moved)) / (np.sum(linear.keep) * max(size, 1e-12))
        out[key] = min(size, misfit), float(np.sqrt(slope @ covariance[np.ix_(mine, mine)] @ slope))
    return out


def rms_of(moved: np.ndarray) -> float:
    """3D rms of displacements (M, 3)."""
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))


def mismatch_table(full: ModelFit, contributions: Contributions, before: PredictiveScore) -> list[MismatchEntry]:
    """Where simulation and recording differ: each location and covariate with its share of the excess chi2, largest first."""
    excess = max(before.chi2 - before.dof, full.model.gain, 1e-9)
    together: dict[tuple[str, str], list[int]] = {}  # several effects at one location, as the orders of a joint, are one entry
    for j, m in enumerate(full.model.members):
        together.setdefault((m.candidate.where[-1], m.candidate.depends_on), []).append(j)
    gains = {key: contributions.of(members) for key, members in together.items()}
    p_values = {key: likelihood_ratio_p(full, members, gains[key]) for key, members in together.items()}
    for cell in full.cells[:1] if full.everywhere else full.cells:
        key = cell.location, cell.depends_on
        # What named and unmodelled effects of one location explain alike is its own share. Groups everywhere are of no one location.
        named = [] if full.everywhere else together.get(key, [])
        gains[key] = max(gains.get(key, 0.0), contributions.of([*named, *contributions.groups_at(full, *key)]))
        p_values[key] = min(p_values.get(key, 1.0), _bayes_p(cell.log_bayes_factor))
    entries = [MismatchEntry(at, on, float(np.clip(gain / excess, 0, 1)), p_values[at, on]) for (at, on), gain in gains.items()]
    return sorted(entries, key=lambda e: -e.share)


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
            corrected = float(-np.expm1(tried * np.log1p(-min(effect.p_value, np.nextafter(1.0, 0.0)))))
            out.append(replace(effect, p_local=effect.p_value, p_corrected=corrected))
            continue
        log = evidence.get(effect.where[0])
        corrected = None if log is None else float(min(1.0, len(evidence) * np.exp(-log)))
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
