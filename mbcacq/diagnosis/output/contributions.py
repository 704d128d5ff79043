"""Contribution of each effect of a model: by how much chi2 rises when the effect is left out and all others are fitted again."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit


class Contributions:
    """Contributions of the parametric effects of a fit, and of the groups of its unmodelled effects, on the data of the fit.

    effects: number of parametric effects; the groups are numbered after them. S, b: normal equations of all coefficients, each in units
    of its prior sigma, with the geometry projected out. total: chi2 that all of them explain together.
    """

    def __init__(self, full: ModelFit):
        joint = full.joint
        self.effects, first = len(joint.effects), len(joint.geometry)
        self.parts = [np.arange(p.start, p.stop) - first for p in (*joint.effects, *joint.groups)]
        if self.parts:
            S, self.b = joint.beyond(joint.geometry)
            self.S = S + np.eye(len(S))
            self.total = float(self.b @ np.linalg.solve(self.S, self.b))

    def of(self, which: list[int]) -> float:
        """The chi2 that these effects and groups explain and the others cannot."""
        others = [p for j, p in enumerate(self.parts) if j not in which]
        if not others:
            return self.total
        index = np.concatenate(others)
        b = self.b[index]
        return self.total - float(b @ np.linalg.solve(self.S[np.ix_(index, index)], b))

    def groups_at(self, full: ModelFit, at: str, depends_on: str | None = None) -> list[int]:
        """Numbers of the groups at a location, of one covariate or of all."""
        return [self.effects + g for g, group in enumerate(full.random) if group.location == at and depends_on in (None, group.depends_on)]
