"""What is stated of an effect, over all sets of effects that the evidence does not exclude.

The standard deviation of a parameter in one set holds if that set is the right one. If other sets with the effect are not excluded, the
parameter is averaged over all of them with the probabilities of the sets (Bayesian model averaging). Its variance is the mean of theirs
plus the variance between them. Two descriptions cannot be told apart if a further effect moves the parameter beyond its uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.order_posterior import LEAST_APART
from mbcacq.diagnosis.evidence.posterior import is_coupled, is_part, not_separable, reported_hypothesis, undecided
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import over_sizes
from mbcacq.diagnosis.search.effect_set import EffectSet, slices_of, typical_sizes
from mbcacq.effects import catalogue
from mbcacq.effects.effect import ParameterEstimate, Parameters, joined_parameters, label_of
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.quantities import K

ByEffect = Mapping[str, Parameters]  # ``name:where`` -> parameters
WeightedSet = tuple[float, ByEffect]  # relative probability of a set of effects, and what it states of each
TURN = 360.0
BY = " by "  # between the name of a parameter per kelvin and its temperature
GENERAL = 1.0  # log odds from which a general function predicts better than names: less is chance
ALIKE = 0.99  # correlation from which it is the same function as they are
ORDERS = ".order"  # end of the name of the parameter that tells several effects of one kind at a joint apart
ANGLES = ("phase_deg", "zero_deg")  # parameters that come round


@dataclass(frozen=True)
class BetweenSets:
    """The sets that the evidence does not exclude, the reported one among them, with what each states.

    sets: by hypothesis. reported: position of the one that is reported; at_best: what that states at its most probable sizes.
    """

    hypotheses: tuple[Hypothesis, ...]
    sets: tuple[WeightedSet, ...]
    reported: int
    at_best: ByEffect

    @classmethod
    def of(cls, fit: EvidenceFit) -> BetweenSets:
        """What the sets of a fit that are not excluded state."""
        reported = reported_hypothesis(fit) if fit.significant else fit.none
        best = max(fit.hypotheses[0].log_posterior, reported.log_posterior)
        likely = [h for h in fit.hypotheses if h is reported or h.log_posterior > best + np.log(OPTIONS.undecided)]
        sets = tuple((float(np.exp(h.log_posterior - best)), by_effect(coefficients_over_sizes(h))) for h in likely)
        return cls(tuple(likely), sets, next(i for i, h in enumerate(likely) if h is reported), by_effect(reported.solved))

    def averaged(self, labels: Iterable[str], parameters: Parameters) -> Parameters:
        """The parameters of some effects (``name:where``) of the reported set, averaged over all sets that have them.

        parameters: as they are reported of that set alone.
        """
        out = dict(parameters)
        for label in labels:
            out |= averaged(label, out, self.at_best, self.sets)
        return out

    def changing(self) -> list[tuple[Hypothesis, frozenset[str]]]:
        """Sets with further effects, beside which reported ones (``name:where``) differ beyond their uncertainty; of sets that contain each
        other, the smallest.
        """
        reported, (_, own) = self.hypotheses[self.reported], self.sets[self.reported]
        found: list[tuple[Hypothesis, frozenset[str]]] = []
        for h, (_, stated) in sorted(zip(self.hypotheses, self.sets, strict=True), key=lambda pair: len(pair[0].labels)):
            further = h.labels > reported.labels or (is_coupled(h) and not is_coupled(reported) and is_part(reported, h))
            if not further or any(other.labels <= h.labels for other, _ in found):
                continue
            changed = frozenset(label for label in own if label in stated and is_changed(own[label], stated[label]))
            if changed:
                found.append((h, changed))
        return sorted(found, key=lambda one: -one[0].log_posterior)


def alternatives_to(fit: EvidenceFit, reported: Hypothesis, everywhere: bool = False) -> list[tuple[Hypothesis, frozenset[str]]]:
    """Sets that the evidence does not exclude in favour of the reported one: others, and those with a further effect beside which reported
    ones (``name:where``) are others.

    One that has an unmodelled effect in place of a catalogued one at the same location, with the same displacement, is no other set: it
    describes the same effect in a more general form. everywhere: whether unmodelled effects stand at all locations; sets that differ by
    such effects alone are no others then.
    """
    others = [(other, frozenset[str]()) for other in undecided(fit, reported) if not _describes_the_same(reported, other)]
    if everywhere:
        others = [one for one in others if any(not label.startswith(UNKNOWN) for label in reported.labels ^ one[0].labels)]
    return [*others, *(BetweenSets.of(fit).changing() if fit.significant else [])]


def better_in_general(fit: EvidenceFit, reported: Hypothesis) -> dict[str, float]:
    """Location -> natural logarithm of the odds by which the data are more probable with a general function there than with the reported
    names, whatever was more probable beforehand. Empty if no such function predicts better.
    """
    out: dict[str, float] = {}
    for other in fit.hypotheses:
        ours, theirs = reported.labels - other.labels, other.labels - reported.labels
        places = {label.partition(":")[2] for label in (*ours, *theirs)}
        general = bool(ours) and {label.partition(":")[0] for label in theirs} == {UNKNOWN}
        gain = other.log_evidence - reported.log_evidence
        if general and len(places) == 1 and gain > GENERAL and likeness(reported, *differing(reported, other)) < ALIKE:
            (at,) = places
            out[at] = max(gain, out.get(at, 0.0))
    return out


def pairs_not_separable(fit: EvidenceFit, everywhere: bool = False) -> list[tuple[NotSeparable, EffectSet, EffectSet]]:
    """Effects that cannot be told apart from those of the reported set, with the coefficients of both sides; none without an effect.
    everywhere: as ``alternatives_to``.
    """
    if not fit.significant:
        return []
    reported, out = reported_hypothesis(fit), []
    for other, changed in alternatives_to(fit, reported, everywhere):
        ours, theirs = differing(reported, other, changed)
        out.append((not_separable(reported, other, likeness(reported, ours, theirs), changed), ours, theirs))
    return out


def differing(one: Hypothesis, other: Hypothesis, changed: frozenset[str] = frozenset()) -> tuple[EffectSet, EffectSet]:
    """The effects that only one of two sets has, or both in other sizes (``changed``), of each set."""
    ours, theirs = (one.labels - other.labels) | changed, (other.labels - one.labels) | changed
    return one.solved.part(lambda m: m.label in ours), other.solved.part(lambda m: m.label in theirs)


def likeness(reported: Hypothesis, ours: EffectSet, theirs: EffectSet) -> float:
    """Absolute correlation of what two sets of effects explain beyond everything else, under the noise of the reported set; 0 where one
    of them explains nothing.
    """
    members = (*ours.members, *theirs.members)
    A = reported.point.with_effects(reported.point.extended(members)).A
    moved, k = np.concatenate([ours.coefficients, theirs.coefficients]) / typical_sizes(members), len(ours.coefficients)
    across = moved[:k] @ A[:k, k:] @ moved[k:]
    size = float(np.sqrt(max((moved[:k] @ A[:k, :k] @ moved[:k]) * (moved[k:] @ A[k:, k:] @ moved[k:]), 0.0)))
    return float(min(abs(across) / size, 1.0)) if size > 0 else 0.0


def _describes_the_same(reported: Hypothesis, other: Hypothesis) -> bool:
    ours, theirs = reported.labels - other.labels, other.labels - reported.labels
    places = [{label.partition(":")[2] for label in labels} for labels in (ours, theirs)]
    if places[0] != places[1] or any(label.partition(":")[0] != UNKNOWN for label in theirs):
        return False
    return bool(np.isclose(likeness(reported, *differing(reported, other)), 1.0))


def coefficients_over_sizes(hypothesis: Hypothesis) -> EffectSet:
    """The effects of a set with the posterior of their coefficients, averaged over their sizes."""
    members = hypothesis.members
    if not members:
        return EffectSet(())
    system = hypothesis.point.with_effects(hypothesis.point.extended(members))
    positive = [m.candidate.positive and m.candidate.k == 1 for m in members]
    chosen = [m.size for m in members]
    sizes = [np.array(m.sizes) if m.size in m.sizes else np.array([m.size]) for m in members]
    mean, covariance = over_sizes(system.A, system.a, list(slices_of(members)), sizes, chosen, positive)
    return EffectSet.in_typical_sizes(members, mean, covariance)


def by_effect(solved: EffectSet) -> ByEffect:
    """What the coefficients of a set state of each effect.

    A change per kelvin of the arm is another quantity than one per kelvin of the air: its name is followed by its temperature. What an
    effect states of another one through which it shows (a payload of the compliance of a joint) is stated of that one.
    """
    each: dict[str, list[Parameters]] = {}
    for member, own in zip(solved.members, solved.slices(), strict=True):
        stated = member.candidate.parameters(solved.coefficients[own], solved.covariance[own, own], member.hyper)
        cause = member.candidate.depends_on
        named = {f"{key}{BY}{cause}" if key.endswith("per_K") else key: value for key, value in stated.items()}
        each.setdefault(member.label, []).append(named)
        coupling = catalogue.declaration(member.candidate.name).coupling
        for key, value in named.items():
            at, _, parameter = key.rpartition(".")
            if coupling is not None and parameter == coupling.parameter:
                each.setdefault(label_of(coupling.through, (at,)), []).append({key: value})
    return {label: joined_parameters(several) for label, several in each.items()}


def averaged(label: str, parameters: Parameters, reported: ByEffect, sets: Sequence[WeightedSet]) -> dict[str, ParameterEstimate]:
    """The parameters of the effect ``label`` that other sets state too, averaged over all these sets.

    parameters: as reported, which may be more uncertain than the coefficients ``reported`` of that set alone say. So the sets move them,
    and add to their variance, by what they differ from these.
    """
    own = reported.get(label, {})
    matched = [(probability, orders_matched(stated.get(label, {}), own)) for probability, stated in sets]
    out: dict[str, ParameterEstimate] = {}
    for stated_as in own:
        key = stated_as.partition(BY)[0]
        each = [(probability, stated[stated_as]) for probability, stated in matched if stated_as in stated]
        each = [(p, e) for p, e in each if alike(e, own[stated_as])]
        if key not in parameters or not each or not alike(parameters[key], own[stated_as]):
            continue
        away = np.array([difference(key, e, own[stated_as]) for _, e in each])
        further = np.array([np.square(e.components[1]) for _, e in each]) - np.square(own[stated_as].components[1])
        known = np.isfinite(away) & np.isfinite(further)  # a set need not have every order
        away, further = np.where(known, away, 0.0), np.where(known, further, 0.0)
        weight = np.where(known, np.array([p for p, _ in each])[:, None], 0.0)
        share = weight / np.maximum(weight.sum(axis=0), 1e-300)
        mean = np.sum(share * away, axis=0)
        values, stds = (np.array(x) for x in parameters[key].components)
        variance = stds**2 + np.sum(share * (np.maximum(further, 0.0) + (away - mean) ** 2), axis=0)
        out[key] = like(parameters[key], values + mean, np.sqrt(variance))
    return out


def orders_matched(other: Parameters, own: Parameters) -> Parameters:
    """The parameters of an effect in another set, each of its several orders at the position of the same one of ``own``; what is stated
    of an order that the other set does not have is not a number.

    Sets list the orders of a gear as they found them: without this, one order would be averaged with another.
    """
    from scipy.optimize import linear_sum_assignment  # 90 modules, that a run never needs

    key = next((key for key in own if key.endswith(ORDERS)), None)
    if key is None or key not in other:
        return other
    (mine, my_std), (theirs, their_std) = (map(np.array, one[key].components) for one in (own, other))
    away = np.abs(mine[:, None] - theirs)
    here, there = linear_sum_assignment(away)
    same = away[here, there] <= np.maximum(LEAST_APART, K * np.hypot(my_std[here], their_std[there]))

    def placed(name: str, stated: ParameterEstimate) -> ParameterEstimate:
        components = np.array(stated.components)
        if name not in own or components.shape[1] != len(theirs):
            return stated
        moved = np.full((2, len(mine)), np.nan)
        moved[:, here[same]] = components[:, there[same]]
        return like(own[name], *moved)

    return {name: placed(name, stated) for name, stated in other.items()}


def is_changed(own: Parameters, other: Parameters) -> bool:
    """Whether a parameter differs by more than its expanded uncertainty, or is of an order that the other set does not have."""
    other = orders_matched(other, own)
    for key in own:
        if key in other and alike(own[key], other[key]) and np.isfinite(own[key].components).all():
            if not np.all(np.abs(difference(key, other[key], own[key])) <= K * np.array(own[key].components[1])):
                return True
    return False


def alike(one: ParameterEstimate, other: ParameterEstimate) -> bool:
    """Whether both have as many components."""
    return np.shape(one.components) == np.shape(other.components)


def difference(key: str, one: ParameterEstimate, other: ParameterEstimate) -> np.ndarray:
    """(k,) of the values; an angle goes the shorter way round."""
    out = np.subtract(one.components[0], other.components[0])
    return (out + TURN / 2) % TURN - TURN / 2 if key.rpartition(".")[2] in ANGLES else out


def like(estimate: ParameterEstimate, values: np.ndarray, stds: np.ndarray) -> ParameterEstimate:
    """An estimate of as many components."""
    if isinstance(estimate.value, tuple):
        return ParameterEstimate(tuple(values.tolist()), tuple(stds.tolist()))
    return ParameterEstimate(float(values[0]), float(stds[0]))
