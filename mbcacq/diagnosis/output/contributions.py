"""Contribution of each effect of a model: by how much chi2 rises when the effect is left out and all others are fitted again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.estimation.random_effect_sizes import joined


class Contributions:
    """Contributions of the parametric effects of a fit, numbered as there, and of the groups of its unmodelled effects, numbered after
    them, on the data of the fit.
    """

    def __init__(self, full: ModelFit):
        joint = full.joint
        first = len(joint.geometry)
        self._parts = [slice(p.start - first, p.stop - first) for p in (*joint.effects, *joint.groups)]
        self._everywhere, count = full.everywhere, len(joint.effects)
        self.named, self.unmodelled = list(range(count)), list(range(count, len(self._parts)))
        if self._parts:
            S, self._b = joint.beyond(joint.geometry)
            self._S = S + np.eye(len(S))

    def of(self, which: Sequence[int]) -> float:
        """The chi2 that these effects and groups explain and the others cannot. Groups that stand at all locations could do what parametric
        effects do: they come after these.
        """
        after = self._everywhere and set(which) <= set(self.named)
        considered = self.named if after else self.named + self.unmodelled
        return self._explained(considered) - self._explained([j for j in considered if j not in which])

    def _explained(self, which: list[int]) -> float:
        """chi2 that these explain together."""
        index = joined([self._parts[j] for j in which])
        return float(self._b[index] @ np.linalg.solve(self._S[np.ix_(index, index)], self._b[index])) if which else 0.0

    def groups_at(self, full: ModelFit, at: str, depends_on: str | None = None) -> list[int]:
        """Numbers of the groups at a location, of one covariate or of all; where they stand at all locations, those of all."""
        chosen = (g.location == at and depends_on in (None, g.depends_on) or self._everywhere for g in full.random)
        return [number for number, mine in zip(self.unmodelled, chosen, strict=True) if mine]
