"""A hypothesis: a set of effects, the noise that is most probable with it, and its evidence.

What is compared may be poses or a motion: each is an ``EvidencePoint``, the rows of a recording at one noise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import log_set_bayes_factor
from mbcacq.diagnosis.search.effect_set import EffectSet, Member, slices_of
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate
from mbcacq.effects.effect_term import UNKNOWN

LARGEST_STEP = 1.0  # of a logarithm of the noise in one round
MOST_CURVED = 4.0  # times its information by which the log posterior of a noise may be curved, as one step shows it


@dataclass(frozen=True, eq=False)
class NormalSystem:
    """Normal equations of effects beyond everything else at one noise: A (k, k), a (k,), coefficients in typical sizes. log_likelihood: of
    everything else alone, with the log prior of the noise, up to a constant of the recording. score: gradient and information of the log
    posterior by the noise, with the effects in place, from the prior weight (k,) of each coefficient.
    """

    A: np.ndarray
    a: np.ndarray
    log_likelihood: float
    score: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class EvidencePoint(Protocol):
    """The rows of a recording at one noise."""

    def extended(self, members: Sequence[Member]) -> Any:
        """The rows with effects, as far as that does not depend on the noise."""

    def with_effects(self, extended: Any) -> NormalSystem:
        """The normal equations of these effects."""
        ...

    def conditioned(self, members: Sequence[Member]) -> Any:
        """The problem with these effects, each at its most probable size, in place; further candidates are scored in it."""

    def solved(self, members: Sequence[Member]) -> EffectSet:
        """These effects with the posterior of their coefficients, each at its most probable size, everything else integrated out."""
        ...

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[Self, np.ndarray]:
        """The point after a step of scoring, and the step of the logarithms."""
        ...

    def forget(self) -> None:
        """Give back the memory of what is computed again where it is asked for."""


P = TypeVar("P", bound=EvidencePoint)


@dataclass(frozen=True, eq=False)
class Hypothesis(Generic[P]):
    """point: of its noise. log_evidence: integrated over geometry, coefficients, hyper-parameters and noise, up to a constant of the
    recording; log_prior: of the set, against none.
    """

    members: tuple[Member, ...]
    point: P
    log_evidence: float
    log_prior: float = 0.0

    def __reduce__(self) -> tuple:
        """Without what is computed again where it is asked for."""
        return Hypothesis, (self.members, self.point, self.log_evidence, self.log_prior)

    @property
    def log_posterior(self) -> float:
        return self.log_evidence + self.log_prior

    @property
    def labels(self) -> frozenset[str]:
        return frozenset(m.label for m in self.members)

    @property
    def key(self) -> tuple[tuple[str, float], ...]:
        return key_of(self.members)

    @property
    def unmodelled(self) -> tuple[Member, ...]:
        return tuple(m for m in self.members if m.candidate.name == UNKNOWN)

    @property
    def catalogued(self) -> tuple[Member, ...]:
        return tuple(m for m in self.members if m.candidate.name != UNKNOWN)

    @cached_property
    def conditioned(self) -> Any:
        """The problem with the effects of the set in place."""
        return self.point.conditioned(self.members)

    @property
    def solved(self) -> EffectSet:
        """The effects with the posterior of their coefficients."""
        return self.point.solved(self.members)

    def forget(self) -> None:
        """Give back the memory of what is computed again where it is asked for: a long recording with its effects in place, and the
        products of all candidates, at this noise."""
        vars(self).pop("conditioned", None)
        self.point.forget()


def key_of(members: Sequence[Member]) -> tuple[tuple[str, float], ...]:
    """Identifies a set of effects."""
    return tuple(sorted(m.key for m in members))


def with_sizes(members: Sequence[Member], A: np.ndarray, a: np.ndarray) -> tuple[tuple[Member, ...], float]:
    """The effects at their most probable sizes, and the log Bayes factor of the set, averaged over sizes and hyper-parameters.

    A (k, k), a (k,): normal equations of all coefficients, in typical sizes, beyond the geometry.
    """
    if not members:
        return (), 0.0
    positive = [m.candidate.positive and m.candidate.k == 1 for m in members]
    total, sizes = log_set_bayes_factor(A, a, list(slices_of(members)), [np.array(m.sizes) for m in members], positive)
    return tuple(replace(m, size=s) for m, s in zip(members, sizes, strict=True)), total + sum(m.log_mass for m in members)


def estimated(members: Sequence[Member], start: P, log_prior: float, rounds: int = OPTIONS.rounds) -> Hypothesis[P]:
    """The hypothesis with its noise estimated anew, from a start.

    The average information may be half of the curvature, and steps by it then go to and fro about the maximum: it counts as much as the
    slope along the last step has changed.
    """
    point, extended, curved = start, start.extended(members), 1.0
    sized, log_density, gradient, information = at_noise(point, members, extended)
    for _ in range(rounds):
        new, step = point.moved(gradient, curved * information)
        if np.abs(step).max() < OPTIONS.steady:
            break
        point, slope = new, float(gradient @ step)
        sized, log_density, gradient, information = at_noise(point, members, extended)
        beyond = -float(gradient @ step)
        if beyond > 0 and slope > 0:
            curved *= min((slope + beyond) / slope, MOST_CURVED)
    return Hypothesis(sized, point, integrated(log_density, gradient, information), log_prior)


def at_noise(point: EvidencePoint, members: Sequence[Member], extended: Any) -> tuple[tuple[Member, ...], float, np.ndarray, np.ndarray]:
    """The effects at their most probable sizes, the log density of data and noise, and its gradient and information by the noise.

    extended: the rows of the recording with these effects.
    """
    system = point.with_effects(extended)
    sized, log_factor = with_sizes(members, system.A, system.a)
    weight = np.concatenate([np.zeros(0), *(np.full(m.candidate.k, m.size**-2) for m in sized)])
    return sized, system.log_likelihood + log_factor, *system.score(weight)


def first_order(members: Sequence[Member], start: P, log_prior: float) -> Hypothesis[P]:
    """The same under the noise of the start, with the evidence that the next step of the noise is expected to reach."""
    return estimated(members, start, log_prior, 0)


def under(point: P, members: Sequence[Member], log_prior: float) -> Hypothesis[P]:
    """The same with the evidence under that noise, as it is."""
    sized, log_density, _, information = at_noise(point, members, point.extended(members))
    return Hypothesis(sized, point, log_density - 0.5 * float(np.linalg.slogdet(information)[1]), log_prior)


def integrated(log_density: float, gradient: np.ndarray, information: np.ndarray) -> float:
    """Laplace's integral over the noise about the maximum that one more step is expected to reach, up to powers of 2 pi that the
    normalised prior has as well.
    """
    step = np.clip(np.linalg.solve(information, gradient), -LARGEST_STEP, LARGEST_STEP)
    expected = float(gradient @ step - 0.5 * step @ information @ step)
    return log_density + expected - 0.5 * float(np.linalg.slogdet(information)[1])


def is_common(candidate: Candidate) -> bool:
    """Whether every arm has the effect."""
    return catalogue.declaration(candidate.name).every_arm and not candidate.rows.extends


@dataclass(frozen=True)
class SetPrior:
    """Prior probabilities of sets: every kind alike, every location of a kind alike, but those that most arms of a class have beside
    another. locations: number of candidates of each kind; given: effects (``name:where``) that are there whatever the set; odds_of_common:
    that an effect which every arm has (friction, elastic joints, drives that lag) shows, where it has odds of its own.
    """

    locations: Counter[str]
    unmodelled_locations: int
    given: frozenset[str] = frozenset()
    odds_of_common: float | None = None

    @classmethod
    def of(
        cls, candidates: Collection[Candidate], unmodelled_locations: int, given: Collection[str] = (), odds_of_common: float | None = None
    ) -> SetPrior:
        return cls(Counter(c.name for c in candidates), max(unmodelled_locations, 1), frozenset(given), odds_of_common)

    def log_probability(self, candidate: Candidate, present: Sequence[Candidate]) -> float:
        """Log prior of one more effect next to those present, as likely of a kind that is there already as not, for many joints of an arm
        are of one make; of the first, given that there is one. Further effects usual in this class of arm are then more probable too.
        """
        if all(c.usual is None for c in (*present, candidate)):
            return self.of_one(candidate, present)
        return self.log_probability_of_set([*present, candidate]) - self.log_probability_of_set(present)

    def of_one(self, candidate: Candidate, present: Sequence[Candidate]) -> float:
        """Log prior of an effect that is not usual beside those present."""
        if self.odds_of_common is not None and is_common(candidate):
            return float(np.log(self.odds_of_common))
        return self._of_kind_and_location(candidate, present) + float(np.log(candidate.rarity))

    def _of_kind_and_location(self, candidate: Candidate, present: Sequence[Candidate]) -> float:
        unmodelled = candidate.name == UNKNOWN
        locations = self.unmodelled_locations if unmodelled else max(self.locations[candidate.name], 1)
        kind = OPTIONS.unmodelled if unmodelled else 1.0 / max(len(self.locations), 1)
        if not present:
            return float(np.log(kind / locations))
        same = [c for c in present if c.name == candidate.name]
        if not same:
            return float(np.log(OPTIONS.further / 2 * kind / locations))
        kinds = len({c.name for c in present})
        here = any(c.where == candidate.where for c in same)
        share = 1.0 / len({c.where for c in same}) if here else 1.0 / locations
        return float(np.log(OPTIONS.further / 2 / kinds * share))

    def log_probability_of_set(self, candidates: Sequence[Candidate]) -> float:
        there = self.given | {c.label for c in candidates}
        odds = [c.usual.odds for c in candidates if c.usual is not None and c.usual.beside in there]
        others = [c for c in candidates if c.usual is None or c.usual.beside not in there]
        return sum(self.of_one(c, others[:j]) for j, c in enumerate(others)) + float(np.sum(np.log(odds)))
