"""A set of named effects, each at its hyper-parameter, solved together with the geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.effects.effect import Candidate

Members = tuple[tuple[Candidate, float | None], ...]


@dataclass(frozen=True)
class EffectSet:
    """A set of effects. gain: of all together over free geometry alone; score: gain less what chance gives to the best of their kinds;
    worth: gain less what evidence takes off, twice the log of a ratio of probabilities.
    """

    members: Members
    gain: float = 0.0
    score: float = 0.0
    worth: float = 0.0
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def parts(self) -> list[slice]:
        ends = np.cumsum([0] + [c.k for c, _ in self.members])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({c.name for c, _ in self.members}))

    @property
    def spots(self) -> tuple[str, ...]:
        """'name:place' of the effects that are at several places."""
        found = dict.fromkeys((c.name, spot(c)) for c, _ in self.members)
        return tuple(at for name, at in found if sum(name == other for other, _ in found) > 1)

    def without(self, keys: tuple[str, ...]) -> EffectSet:
        """The other effects, to be solved anew; this very model where it has none of these. keys: names, or 'name:place'."""
        members = tuple(m for m in self.members if m[0].name not in keys and spot(m[0]) not in keys)
        return self if len(members) == len(self.members) else EffectSet(members)


def spot(candidate: Candidate) -> str:
    return f"{candidate.name}:{'+'.join(candidate.where)}"


NOTHING = EffectSet(())
