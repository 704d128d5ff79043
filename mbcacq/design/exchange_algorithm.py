"""Choice of the best few of many poses: greedy growth, then exchange, on small information blocks of all candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.design.optimality_criteria import Criterion, DOptimality, updated_covariance
from mbcacq.design.options import OPTIONS


def choose_by_exchange(base: np.ndarray, blocks: np.ndarray, groups: np.ndarray, count: int, criterion: Criterion) -> list[int]:
    """Indices of ``count`` candidates, best as far as greedy growth and exchanges of single poses go.

    base: (G, G) information known without them, invertible; blocks: (P, r, G), see ``optimality_criteria``; groups: (P,) station of each.
    """
    chosen, C = _greedy_growth(base, blocks, groups, count, criterion)
    return _exchange(chosen, C, blocks, criterion)


def _greedy_growth(
    base: np.ndarray, blocks: np.ndarray, groups: np.ndarray, count: int, criterion: Criterion
) -> tuple[list[int], np.ndarray]:
    """Indices one after the other, and the covariance with them.

    It starts with two poses at each station, as a single one is spent on finding the station and would look useless.
    """
    C = np.linalg.inv(base)
    chosen: list[int] = []
    everything = DOptimality(len(base))
    stations: Sequence = [s for s in np.unique(groups) for _ in range(2)][:count]
    for k in range(count):
        free = np.ones(len(blocks), bool)
        free[chosen] = False
        if k < len(stations):
            free &= groups == stations[k]
        if not free.any():
            continue
        gains = np.where(free, (everything if k < len(stations) else criterion).gains(C, blocks, 1.0), -np.inf)
        chosen.append(int(np.argmax(gains)))
        C = updated_covariance(C, blocks[chosen[-1]], 1.0)
    return chosen, C


def _exchange(chosen: list[int], C: np.ndarray, blocks: np.ndarray, criterion: Criterion) -> list[int]:
    """The chosen poses after exchanging the least useful one for the most useful other, as long as that helps."""
    chosen = list(chosen)
    for _ in range(OPTIONS.exchange_rounds * len(chosen)):
        before = criterion.value(C)
        spare = int(np.argmax(criterion.gains(C, blocks[chosen], -1.0)))
        without = updated_covariance(C, blocks[chosen[spare]], -1.0)
        gains = criterion.gains(without, blocks, 1.0)
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        after = updated_covariance(without, blocks[best], 1.0)
        if criterion.value(after) >= before - OPTIONS.least_improvement * abs(before):
            break
        chosen[spare] = best
        C = after
    return chosen
