"""A set of parametric effects, each at its hyper-parameter, solved together with the geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.effects.effect import Candidate


@dataclass(frozen=True)
class EffectSet:
    """Selected effects, with the coefficients of all of them and their covariance. gain: chi2 that all together gain over free geometry
    alone.
    """

    effects: tuple[tuple[Candidate, float | None], ...]
    gain: float = 0.0
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def slices(self) -> list[slice]:
        """Which coefficients belong to which effect."""
        ends = np.cumsum([0] + [c.k for c, _ in self.effects])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({c.name for c, _ in self.effects}))

    @property
    def located_names(self) -> tuple[str, ...]:
        """'name:location' of the effects that are at several locations."""
        found = dict.fromkeys((c.name, c.label) for c, _ in self.effects)
        return tuple(located for name, located in found if sum(name == other for other, _ in found) > 1)


NO_EFFECTS = EffectSet(())
