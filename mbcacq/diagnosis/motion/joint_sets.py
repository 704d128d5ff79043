"""Sets of effects of poses and of motion of one run together: one evidence of both kinds of rows, in which a shared effect is one.

1. A set of each evidence (poses, and every kind of mismatch of the motion) makes a joint set. Effects that were compared in several of
   them are in all of these or in none.
2. The evidences of independent rows multiply. A shared effect has one prior probability and one coefficient, so that its second prior is
   taken off, and its evidence is that of one coefficient behind both (``log_shared``). The evidence of poses to which the effect was
   given as their prior (``given_effects``) has that already.
3. A question that neither decides alone, because another set is not excluded there, is decided where the joint sets exclude it. Both may
   show what neither shows alone.
4. That the masses of the links may stand for a load (``load_error``) is a question beside the sets. What the other evidences add to
   the odds of the load decides it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import chdtrc, ndtri

from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE
from mbcacq.diagnosis.evidence.between_sets import TURN, difference
from mbcacq.diagnosis.findings import TOGETHER, ComparedEffect, ComparedSet, EvidenceSummary, NotSeparable
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect import ParameterEstimate, Parameters
from mbcacq.model.json_text import Number
from mbcacq.quantities import split_unit

MOST_SETS = 12  # of each evidence: further ones are less probable than the best by far
SAME_ORDER = 0.5  # periods a turn within which two periodic components are the same
PHASE = "phase_deg"
UNIFORM_DEG = TURN / np.sqrt(12.0)  # standard deviation of an angle of which nothing is known


@dataclass(frozen=True)
class JointSet:
    """effects: labels; log_odds: natural logarithm of the posterior probability relative to the most probable joint set's."""

    effects: tuple[str, ...]
    log_odds: Number


@dataclass(frozen=True)
class JointEvidence:
    """What poses and motion show together.

    sets: the most probable first. log_e_value: natural logarithm of the evidence of all sets with an effect together against none, minus
    infinity where no joint set is without effects; above least_log_e_value there is an effect.
    """

    sets: tuple[JointSet, ...]
    log_e_value: Number
    least_log_e_value: Number = LEAST_LOG_E_VALUE

    @property
    def significant(self) -> bool:
        """Whether there is an effect."""
        return self.log_e_value > self.least_log_e_value

    @property
    def decided(self) -> bool:
        """Whether the most probable set is the only one: others are part of it, or excluded."""
        return bool(self.sets) and not not_excluded(self.sets)

    @property
    def reported(self) -> tuple[str, ...]:
        """The effects of the most probable set, where there is an effect."""
        return self.sets[0].effects if self.significant and self.sets else ()


def joint_evidence(evidences: Sequence[EvidenceSummary], given: Collection[str] = ()) -> JointEvidence:
    """All consistent joint sets; none if the evidences share no consistent one.

    evidences: with parameters in the words of the poses. given: effects whose prior in one evidence is the value that the others state.
    """
    each = [[by_label(one) for one in evidence.sets] for evidence in evidences]
    known = [frozenset(label for one in sets for label in one) for sets in each]
    shared = {label for i, one in enumerate(known) for label in one if any(label in other for other in known[:i])}
    found: dict[frozenset[str], float] = {}
    for picks in product(*map(_most_probable, evidences)):
        sets = [some[i] for some, i in zip(each, picks, strict=True)]
        if any(len({label in s for s, k in zip(sets, known, strict=True) if label in k}) > 1 for label in shared):
            continue
        log = sum(one.sets[i].log_odds for one, i in zip(evidences, picks, strict=True))
        log += sum(log_of_one([s[label] for s in sets if label in s]) for label in sorted(shared.difference(given)))
        labels = frozenset(label for s in sets for label in s)
        found[labels] = float(np.logaddexp(found.get(labels, -np.inf), log))
    best = max(found.values(), default=0.0)
    ranked = sorted(found.items(), key=lambda item: -item[1])
    some = [log for labels, log in ranked if labels]
    log_e = float(np.logaddexp.reduce(some)) - found.get(frozenset(), np.inf) if some else -np.inf
    log_e -= sum(map(_log_prior_mass, evidences))
    return JointEvidence(tuple(JointSet(tuple(sorted(labels)), log - best) for labels, log in ranked), log_e)


def by_label(one: ComparedSet) -> dict[str, ComparedEffect]:
    """What a set states of each effect; several forms of one effect are one."""
    out: dict[str, ComparedEffect] = {}
    for effect in one.effects:
        before = out.get(effect.label)
        if before is not None:
            parameters, prior = {**before.parameters, **effect.parameters}, {**before.prior, **effect.prior}
            effect = replace(effect, parameters=parameters, prior=prior, log_prior=_log_prior(before) + _log_prior(effect))
        out[effect.label] = effect
    return out


def _log_prior(effect: ComparedEffect) -> float:
    """Log prior probability of an effect next to the others of its set; without one (older files) the joint odds are understated."""
    return effect.log_prior or 0.0


def _most_probable(evidence: EvidenceSummary) -> list[int]:
    """Indices of the most probable sets, and of the empty one, against which an effect is shown."""
    best = np.argsort([one.log_odds for one in evidence.sets])[::-1].tolist()
    return [i for rank, i in enumerate(best) if rank < MOST_SETS or not evidence.sets[i].effects]


def _log_prior_mass(evidence: EvidenceSummary) -> float:
    """Log of the most that the prior probabilities of the sets can add up to, by which the e-value of an evidence is divided."""
    log_odds = np.array([one.log_odds for one in evidence.sets])
    some = np.array([bool(one.effects) for one in evidence.sets])
    if not some.any() or some.all() or not np.isfinite(evidence.log_e_value):
        return 0.0
    return max(float(np.logaddexp.reduce(log_odds[some]) - log_odds[~some].max()) - evidence.log_e_value, 0.0)


def log_odds_of(label: str, sets: Iterable[tuple[Collection[str], float]]) -> float:
    """Natural logarithm of the odds of an effect: all sets with it against all without, each given by its labels and log odds.

    Sets that are less probable than the best by more than ``OPTIONS.reach`` are not kept, so larger odds are not known.
    """
    logs: dict[bool, list[float]] = {True: [-np.inf], False: [-np.inf]}
    for labels, log in sets:
        logs[label in labels].append(log)
    with_it, without = (float(np.logaddexp.reduce(logs[there])) for there in (True, False))
    return float(np.clip(with_it - without, -OPTIONS.reach, OPTIONS.reach))


def log_of_one(stated: Sequence[ComparedEffect]) -> float:
    """By how much the log posterior of an effect that several evidences state changes when it is one effect with one set of parameters.

    The parameters that both state are compared as if they were independent, those of further evidences with those of the first.
    """
    total = 0.0
    for other in stated[1:]:
        total -= _log_prior(other)
        for key, mine, theirs in paired(stated[0].parameters, other.parameters):
            components = len(mine.components[0])
            priors = [one for one in (prior_of(evidence, key, components) for evidence in (stated[0], other)) if one is not None]
            total += float(np.sum(log_shared(key, mine, theirs, priors)))
    return total


def prior_of(stated: ComparedEffect, key: str, components: int) -> ParameterEstimate | None:
    """A parameter before the recording. Its value without the effect may be no number."""
    prior = stated.prior.get(key)
    values, stds = ((), ()) if prior is None else prior.components
    return prior if len(values) == len(stds) == components and np.isfinite(stds).all() else None


def log_shared(key: str, mine: ParameterEstimate, theirs: ParameterEstimate, priors: Sequence[ParameterEstimate]) -> np.ndarray:
    """(k,) log evidence of one parameter behind two independent recordings, over the product of those of a parameter for each.

    priors: of the first and the second recording, which may take the effect to be of another size; or the only one that is known, for both.
    With normal posteriors p1, p2 and priors q1, q2 the evidence with the prior q is the integral of q p1 p2 / (q1 q2), where q is q1 or q2,
    equally probable. Without a prior, half the squared distance in combined standard deviations is taken off, which understates it.
    """
    away = difference(key, mine, theirs)
    if not priors:
        return -0.5 * away**2 / np.maximum(np.square(mine.components[1]) + np.square(theirs.components[1]), 1e-300)
    first, second = priors[0], priors[-1]
    return np.logaddexp(_log_shared(key, mine, theirs, second), _log_shared(key, theirs, mine, first)) - np.log(2.0)


def _log_shared(key: str, mine: ParameterEstimate, theirs: ParameterEstimate, prior: ParameterEstimate) -> np.ndarray:
    """(k,) logarithm of the integral of the posteriors p1 p2 over the prior of the second."""
    (value, std), (_, other) = np.array(mine.components), np.array(theirs.components)
    away, first, second = difference(key, mine, theirs), std**2, other**2
    absent, spread = np.array(prior.components)
    about = np.where(np.isfinite(absent) & (name_of(key) != PHASE), value - absent, 0.0)
    spread = np.minimum(spread, UNIFORM_DEG) if name_of(key) == PHASE else spread
    before = np.maximum(spread**2, second)  # a posterior is not wider than its prior
    precision = 1 / first + 1 / second - 1 / before
    mean = (about / first + (about - away) / second) / precision
    exponent = about**2 / first + (about - away) ** 2 / second - precision * mean**2
    return 0.5 * np.log(before / (first * second * precision)) - 0.5 * exponent


def name_of(key: str) -> str:
    """The parameter's name without its location."""
    return key.rpartition(".")[2]


def paired(own: Parameters, other: Parameters) -> Iterator[tuple[str, ParameterEstimate, ParameterEstimate]]:
    """The parameters that both have, if all are finite. Parameters of one order belong together if a periodic effect has several orders."""
    for key in own:
        location = key.rpartition(".")[0]
        orders = f"{location}.order" if location else "order"
        if key not in other:
            continue
        mine, theirs = own[key].components, other[key].components
        if orders not in own or orders not in other:
            if np.shape(mine) == np.shape(theirs) and np.isfinite([mine, theirs]).all():
                yield key, own[key], other[key]
            continue
        for j, i in same_orders(own[orders], other[orders]):
            one, two = ((values[at], stds[at]) for (values, stds), at in ((mine, j), (theirs, i)))
            if np.isfinite([one, two]).all():
                yield key, ParameterEstimate(*one), ParameterEstimate(*two)


def same_orders(own: ParameterEstimate, other: ParameterEstimate) -> list[tuple[int, int]]:
    """Positions of periodic components that are the same, in both orders."""
    apart_by = np.abs(np.subtract.outer(own.components[0], other.components[0]))
    return [(j, int(row.argmin())) for j, row in enumerate(apart_by) if row.min() < SAME_ORDER]


def not_excluded(sets: Sequence[JointSet]) -> tuple[JointSet, ...]:
    """Joint sets, neither part nor extension of the most probable one, that have more than a twentieth of its probability."""
    if not sets:
        return ()
    best = set(sets[0].effects)
    least = float(np.log(OPTIONS.undecided))
    return tuple(s for s in sets[1:] if s.log_odds > least and not (best <= set(s.effects) or best >= set(s.effects)))


FARTHEST = 38.0  # standard deviations: beyond, the probability of a normal distribution is no floating point number


@dataclass(frozen=True)
class ParameterAgreement:
    """A parameter of an effect that was found in the poses and in the motion.

    Attributes
    ----------
    name, where, parameter
        The effect, its locations, and the parameter with its unit.
    poses, motion
        Both estimates.
    sigmas
        Their distance in combined standard deviations; several components have the distance of one that is as improbable as all together.
    agrees
        Whether that is less than three.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    poses: ParameterEstimate
    motion: ParameterEstimate
    sigmas: Number
    agrees: bool

    @property
    def label(self) -> str:
        """Effect, locations and parameter in words."""
        return f"{self.name} at {'+'.join(self.where)}, {split_unit(self.parameter)[0]}"

    def stated(self) -> tuple[str, str]:
        """What the poses and what the motion state, each with its expanded uncertainty."""
        _, unit, factor = split_unit(self.parameter)
        return self.poses.shown(unit, factor), self.motion.shown(unit, factor)

    def __str__(self) -> str:
        of_poses, of_motion = self.stated()
        verdict = "they agree" if self.agrees else "they contradict each other"
        return f"{self.label}: {of_poses} from the poses, {of_motion} from the motion: {verdict} ({self.sigmas:.1f} sigma)"


@dataclass(frozen=True)
class DecidedPair:
    """Effects that one diagnosis cannot tell apart, of which one is named. by: 'poses' or 'motion', where the other one names it by itself;
    'both', where the evidence of both does.
    """

    effects: tuple[str, ...]
    named: str
    by: str

    def __str__(self) -> str:
        pair = " and ".join(self.effects)
        if self.by == "both":
            return f"one of them cannot separate {pair}: both together name {self.named}"
        other, name = ("motion", "name") if self.by == "poses" else ("poses", "names")
        return f"the {other} cannot separate {pair}: the {self.by} {name} {self.named}"


def named_side(pair: NotSeparable, labels: Collection[str]) -> list[str]:
    """The sides of a pair whose effects are all among these labels. Only the larger set can be named if one side has the effects of the
    other and more: without the further ones the other is not confirmed.
    """
    parts = [set(side.split(TOGETHER)) for side in pair.effects]
    larger = [side for side, own, other in zip(pair.effects, parts, parts[::-1], strict=True) if own > other]
    return [side for side in larger or pair.effects if set(side.split(TOGETHER)) <= set(labels)]


def distance_of(key: str, mine: ParameterEstimate, theirs: ParameterEstimate) -> float:
    """Distance of two estimates in combined standard deviations."""
    sigmas = np.abs(difference(key, mine, theirs)) / np.maximum(np.hypot(mine.components[1], theirs.components[1]), 1e-300)
    if len(sigmas) == 1:
        return float(sigmas[0])
    probability = float(chdtrc(len(sigmas), np.sum(sigmas**2)))
    return float(-ndtri(probability / 2)) if probability > 0 else max(FARTHEST, float(sigmas.max()))
