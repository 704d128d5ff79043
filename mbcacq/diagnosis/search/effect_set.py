"""An effect of a set at a value of its hyper-parameter, and the set of them solved together with the geometry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.bayes_factor import posterior_of
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.random_effect_sizes import consecutive

NO_COLUMNS, NO_COEFFICIENTS = np.zeros(0, dtype=int), np.zeros(0)


def possible_sizes(least: float) -> tuple[float, ...]:
    """Sizes of the coefficients of an effect, in typical ones, of which the least is given."""
    return tuple(size for size in OPTIONS.sizes if size >= least)


@dataclass(frozen=True)
class Member:
    """An effect of a set, or one that may be, at one value of its hyper-parameter.

    sizes: of its coefficients that are possible, in typical ones (those of the candidate, unless given); size: the most probable; log_mass:
    log of the average over the hyper-parameter, relative to this value. columns: (k,) their numbers among those of a motion; none of an
    effect of poses. coefficients: (k,) where they are known, inf where the geometry absorbs the effect.
    """

    candidate: Candidate
    hyper: float | None
    log_mass: float = 0.0
    sizes: tuple[float, ...] = ()
    size: float = 1.0
    columns: np.ndarray = field(default_factory=lambda: NO_COLUMNS, compare=False)
    coefficients: np.ndarray = field(default_factory=lambda: NO_COEFFICIENTS, compare=False)

    def __post_init__(self) -> None:
        if not self.sizes:
            object.__setattr__(self, "sizes", possible_sizes(self.candidate.least_size))

    @property
    def label(self) -> str:
        """``name:where``; several harmonics of a joint are one effect."""
        return self.candidate.label

    @property
    def key(self) -> tuple[str, float]:
        """Identifies it in a set, in which hyper-parameters that round alike are one."""
        digits, value = self.candidate.rows.hyper_digits, self.hyper or 0.0
        return self.candidate.key, value if digits is None else round(value, digits)

    @property
    def in_typical_sizes(self) -> float:
        """The largest coefficient, relative to its typical size."""
        return float((self.coefficients / self.candidate.typical).max())

    @property
    def value(self) -> float:
        """The hyper-parameter of an effect that has one."""
        assert self.hyper is not None, f"{self.candidate.name} has no hyper-parameter"
        return self.hyper


def prior_sigma(members: Sequence[Member]) -> np.ndarray:
    """(k,) prior standard deviation of each coefficient, at the most probable size of its effect."""
    return np.concatenate([np.zeros(0), *(m.size * m.candidate.typical for m in members)])


def typical_sizes(members: Sequence[Member]) -> np.ndarray:
    """(k,) typical size of each coefficient."""
    return np.concatenate([np.zeros(0), *(m.candidate.typical for m in members)])


def slices_of(members: Sequence[Member]) -> tuple[slice, ...]:
    """Which coefficients belong to which effect."""
    return consecutive(m.candidate.k for m in members)


@dataclass(frozen=True)
class EffectSet:
    """Effects with the coefficients (k,) of all of them and their covariance (k, k), where they were solved. gain: chi2 that all together
    gain over free geometry alone.
    """

    members: tuple[Member, ...]
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gain: float = 0.0

    @classmethod
    def unsolved(cls, members: Sequence[Member]) -> EffectSet:
        """Effects whose coefficients will be found by something else."""
        k = sum(m.candidate.k for m in members)
        return cls(tuple(members), np.zeros(k), np.zeros((k, k)))

    @classmethod
    def of(cls, members: Sequence[Member], A: np.ndarray, a: np.ndarray) -> EffectSet:
        """Effects with the posterior of their coefficients, each at its most probable size. A (k, k), a (k,): normal equations beyond
        everything else, of coefficients in typical sizes."""
        size = np.concatenate([np.zeros(0), *(np.full(m.candidate.k, m.size) for m in members)])
        return cls.in_typical_sizes(members, *posterior_of(A, a, size))

    @classmethod
    def in_typical_sizes(cls, members: Sequence[Member], coefficients: np.ndarray, covariance: np.ndarray) -> EffectSet:
        """Effects of which coefficients and covariance are in typical sizes."""
        typical = typical_sizes(members)
        return cls(tuple(members), typical * coefficients, covariance * np.outer(typical, typical))

    def slices(self) -> tuple[slice, ...]:
        """Which coefficients belong to which effect."""
        return slices_of(self.members)

    def part(self, chosen: Callable[[Member], bool]) -> EffectSet:
        """Some of the effects, without the gain, which is of all."""
        own = [(m, p) for m, p in zip(self.members, self.slices(), strict=True) if chosen(m)]
        index = np.concatenate([np.zeros(0, int), *(np.arange(p.start, p.stop) for _, p in own)])
        return EffectSet(tuple(m for m, _ in own), self.coefficients[index], self.covariance[np.ix_(index, index)])

    @property
    def with_coefficients(self) -> tuple[Member, ...]:
        """The effects, each with its coefficients."""
        return tuple(replace(m, coefficients=self.coefficients[p]) for m, p in zip(self.members, self.slices(), strict=True))

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(m.label for m in self.members)

    @property
    def std(self) -> np.ndarray:
        """(k,) standard deviation of each coefficient."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({m.candidate.name for m in self.members}))

    @property
    def located_names(self) -> tuple[str, ...]:
        """'name:location' of the effects that are at several locations."""
        found = dict.fromkeys((m.candidate.name, m.label) for m in self.members)
        return tuple(located for name, located in found if sum(name == other for other, _ in found) > 1)


NO_EFFECTS = EffectSet(())
