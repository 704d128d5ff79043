"""What each member of a model is worth beside the others: by how much chi2 rises when it is left out and the rest is fitted again."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.search.projected_solve import prior_sigma


class Contributions:
    """Of a finding, on the data it was found with."""

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
        """chi2 lost without these: members by their number, groups by their number after the last member."""
        left = [p for j, p in enumerate(self.parts) if j not in which]
        if not left:
            return self.total
        index = np.concatenate(left)
        b = self.b[index]
        return self.total - float(b @ np.linalg.solve(self.S[np.ix_(index, index)], b))

    def groups_at(self, full: ModelFit, at: str, depends_on: str | None = None) -> list[int]:
        """Numbers of the groups at a place."""
        if full.smooth is None:
            return []
        groups = enumerate(full.smooth.groups)
        return [self.effects + g for g, group in groups if group.location == at and depends_on in (None, group.depends_on)]
