"""Contribution of each effect of a model: by how much chi2 rises when the effect is left out and all others are fitted again."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.search.projected_solve import prior_sigma


class Contributions:
    """Contributions of the parametric effects of a fit, and of the groups of its unmodelled effects, on the data of the fit.

    effects: number of parametric effects; the groups are numbered after them. S, b: normal equations of all coefficients, each in units
    of its prior sigma, with the geometry projected out. total: chi2 that all of them explain together.
    """

    def __init__(self, full: ModelFit):
        screen, model, rest = full.geometry_only, full.model, full.smooth
        blocks, sigma = [], []
        for candidate, hyper in model.effects:
            blocks.append(screen.block(candidate, hyper))
            sigma.append(prior_sigma(candidate))
        self.effects = len(blocks)
        if rest is not None:
            X = screen.whiten(rest.columns)
            blocks += [X[:, p] for p in rest.slices()]
            sigma += [rest.sigma[p] for p in rest.slices()]
        ends = np.cumsum([0] + [b.shape[1] for b in blocks])
        self.parts = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        if blocks:
            X = np.concatenate(blocks, axis=1) * np.concatenate(sigma)
            taken = screen.Q.T @ X
            self.S, self.b = X.T @ X - taken.T @ taken + np.eye(X.shape[1]), X.T @ screen.r
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
        if full.smooth is None:
            return []
        return [
            self.effects + g
            for g, group in enumerate(full.smooth.groups)
            if group.location == at and depends_on in (None, group.depends_on)
        ]
