"""Many candidates scored in one product: their columns side by side, the normal matrices of those of one size in one array."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.whitening import CentreWhitening


class FixedBlocks:
    """The candidates whose columns need no scan, each at every value of its hyper-parameter.

    entries: (candidate, value); columns (M, R, K): all of theirs. sizes: of those with k coefficients, which entries (n,), which columns
    (n, k).
    """

    def __init__(self, candidates: list[Candidate], linear: LinearProblem):
        self.entries = [(c, h) for c in candidates if not c.components for h in (c.hyper.values if c.hyper else (None,))]
        each = [candidate_columns(linear, c, h) for c, h in self.entries]
        self.columns = np.concatenate(each, axis=2) if each else np.zeros((*linear.residual.shape, 0))
        widths = np.array([e.shape[2] for e in each], dtype=int)
        starts = np.cumsum(widths) - widths
        self.sizes = []
        for k in np.unique(widths):
            chosen = np.flatnonzero(widths == k)
            self.sizes.append((chosen, starts[chosen][:, None] + np.arange(k)))

    @staticmethod
    def of(candidates: list[Candidate], linear: LinearProblem) -> FixedBlocks:
        """Made once for a linearisation."""
        return linear.computed_once(candidate_keys(candidates), lambda: FixedBlocks(candidates, linear))


def candidate_keys(candidates: list[Candidate]) -> tuple[str, ...]:
    return tuple(c.key for c in candidates)


@dataclass(frozen=True)
class BatchScoring:
    """Under one noise model: whitened columns X (rows, K), and of each size S (n, k, k) and b (n, k), geometry projected out."""

    fixed: FixedBlocks
    X: np.ndarray
    blocks: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(
        cls,
        candidates: list[Candidate],
        linear: LinearProblem,
        whiten: CentreWhitening,
        absorbed_of: Callable[[np.ndarray], np.ndarray],
        r: np.ndarray,
    ) -> BatchScoring:
        """absorbed_of: products (z, k) of whitened columns with the basis of what geometry absorbs; r (rows,): residual beyond it."""
        fixed = FixedBlocks.of(candidates, linear)
        X = whiten(fixed.columns)
        absorbed, b = absorbed_of(X), X.T @ r
        blocks = []
        for _, columns in fixed.sizes:
            own, gone = X.T[columns], absorbed.T[columns]
            blocks.append((own @ np.swapaxes(own, 1, 2) - gone @ np.swapaxes(gone, 1, 2), b[columns]))
        return cls(fixed, X, blocks)
