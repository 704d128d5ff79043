"""Many fixed candidates weighed at once: their blocks of the normal matrix side by side, those of one size in one array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbcacq.diagnosis.blocks import prior_weight, solve_blocks
from mbcacq.physics.effect import Candidate

if TYPE_CHECKING:
    from mbcacq.diagnosis.screen import Screen


@dataclass(frozen=True)
class Size:
    """The candidates of k coefficients: which entries (n,), their columns (n, k); S (n, k, k), b, raw and weight (n, k) of their blocks."""

    entries: np.ndarray
    columns: np.ndarray
    S: np.ndarray
    b: np.ndarray
    raw: np.ndarray
    weight: np.ndarray


class Bench:
    """entries: (candidate, value of its hyper-parameter) whose columns need no scan; X (rows, K): all of them, whitened."""

    def __init__(self, candidates: list[Candidate], screen: Screen):
        self.candidates = candidates
        self.entries = [(c, h) for c in candidates if not c.separable for h in (c.hyper.values if c.hyper else (None,))]
        blocks = [screen.block(c, h) for c, h in self.entries]
        self.X = np.concatenate(blocks, axis=1) if blocks else np.zeros((len(screen.r0), 0))
        starts = np.cumsum([0] + [b.shape[1] for b in blocks])[:-1]
        widths = np.array([b.shape[1] for b in blocks], dtype=int)
        self.sizes = [self._of_size(screen, np.flatnonzero(widths == k), starts, k) for k in np.unique(widths)]

    def _of_size(self, screen: Screen, entries: np.ndarray, starts: np.ndarray, k: int) -> Size:
        parts = [screen.prepared(*self.entries[e])[1:] for e in entries]
        columns = starts[entries][:, None] + np.arange(k)
        raw = np.sum(self.X * self.X, axis=0)[columns]
        weight = np.array([prior_weight(self.entries[e][0]) for e in entries])
        return Size(entries, columns, np.array([S for S, _ in parts]), np.array([b for _, b in parts]), raw, weight)

    def best(self, screen: Screen) -> dict[str, tuple[float | None, float]]:
        """Candidate's key -> its best value of the hyper-parameter and the gain there, with what the screen has adopted projected out."""
        gains = np.zeros(len(self.entries))
        taken = screen.more.T @ self.X if screen.more.shape[1] else None
        for size in self.sizes:
            S, b = size.S, size.b
            if taken is not None:
                T = taken[:, size.columns].transpose(1, 2, 0)
                S, b = S - T @ np.swapaxes(T, 1, 2), b - T @ screen.taken
            gains[size.entries] = solve_blocks(S, b, size.raw, size.weight)
        out: dict[str, tuple[float | None, float]] = {}
        for (candidate, hyper), gain in zip(self.entries, gains, strict=True):
            if candidate.key not in out or gain > out[candidate.key][1]:
                out[candidate.key] = hyper, float(gain)
        return out
