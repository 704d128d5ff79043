"""Choice of the best few of many poses: greedy growth, then exchange, on small information blocks of all candidates at once.

Each candidate is a block B (6, G): the whitened rows of one pose by all G unknowns (arm, hand-eye, six of each station). With M the
information so far and C its inverse, a pose turns C into C - C B' inv(I + B C B') B C; what that gains is computed for all
candidates in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Criterion:
    """target: (G, G) whose product with C is to become small (A-optimality: mean variance of what ``target`` = rows' rows stands for);
    None: the determinant of the first ``own`` unknowns' covariance (D-optimality)."""

    own: int
    target: np.ndarray | None = None

    def value(self, C: np.ndarray) -> float:
        """The smaller the better: a variance, or the logarithm of a volume."""
        if self.target is not None:
            return float(np.sum(self.target * C))
        return float(np.linalg.slogdet(C[: self.own, : self.own])[1])

    def gains(self, C: np.ndarray, B: np.ndarray, sign: float) -> np.ndarray:
        """(P,) decrease of ``value`` by adding (sign 1) or taking away (sign -1) each block of B (P, r, G)."""
        BC = B @ C
        S = np.eye(B.shape[1]) + sign * BC @ np.swapaxes(B, 1, 2)
        if self.target is not None:
            gain = sign * np.trace(np.linalg.solve(S, BC @ self.target @ np.swapaxes(BC, 1, 2)), axis1=1, axis2=2)
        else:
            # The own unknowns' volume is that of all, less that of the stations with the own ones known.
            rest = slice(self.own, None)
            inner = np.linalg.inv(np.linalg.inv(C)[rest, rest]) if C.shape[0] > self.own else np.zeros((0, 0))
            T = np.eye(B.shape[1]) + sign * B[..., rest] @ inner @ np.swapaxes(B[..., rest], 1, 2)
            gain = np.linalg.slogdet(S)[1] - np.linalg.slogdet(T)[1]
        if sign < 0:
            # A pose that alone carries a direction cannot be spared.
            gain = np.where(np.linalg.eigvalsh(S)[:, 0] > 1e-9, gain, -np.inf)
        return gain


def choose(base: np.ndarray, blocks: np.ndarray, groups: np.ndarray, count: int, criterion: Criterion, rounds: int = 4) -> list[int]:
    """Indices of ``count`` candidates, best as far as greedy growth and exchanges of single poses go.

    base: (G, G) information known without them, invertible; blocks: (P, r, G); groups: (P,) station of each. Growth starts with two poses
    at each station, as a single one is spent on finding the station and would look useless.
    """
    C = np.linalg.inv(base)
    chosen: list[int] = []
    everything = Criterion(len(base))
    stations = [s for s in np.unique(groups) for _ in range(2)][:count]
    for k in range(count):
        free = np.ones(len(blocks), bool)
        free[chosen] = False
        if k < len(stations):
            free &= groups == stations[k]
        if not free.any():
            continue
        gains = np.where(free, (everything if k < len(stations) else criterion).gains(C, blocks, 1.0), -np.inf)
        chosen.append(int(np.argmax(gains)))
        C = updated(C, blocks[chosen[-1]], 1.0)
    for _ in range(rounds * len(chosen)):
        before = criterion.value(C)
        spare = int(np.argmax(criterion.gains(C, blocks[chosen], -1.0)))
        without = updated(C, blocks[chosen[spare]], -1.0)
        gains = criterion.gains(without, blocks, 1.0)
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        after = updated(without, blocks[best], 1.0)
        if criterion.value(after) >= before - 1e-6 * abs(before):
            break
        chosen[spare] = best
        C = after
    return chosen


def updated(C: np.ndarray, B: np.ndarray, sign: float) -> np.ndarray:
    """Covariance after adding (1) or taking away (-1) a block B (r, G), symmetric to the last digit."""
    BC = B @ C
    out = C - sign * BC.T @ np.linalg.solve(np.eye(len(B)) + sign * BC @ B.T, BC)
    return 0.5 * (out + out.T)
