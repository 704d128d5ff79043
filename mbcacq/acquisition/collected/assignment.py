"""Which cloud was taken at which pose: by their order, and by what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.acquisition.collected.found_cloud import FoundCloud
from mbcacq.acquisition.collected.placement_fit import PlacementFit

FAR_MM, NEAR_MM = 40.0, 12.0  # how far a cloud may be from its pose: as planned, and once scanner and stations are known from others
LEAST_NEAR_MM, NEAR_TIMES = 3.0, 6.0  # in the end: so many times the median of all pairs, which is the error of the nominal arm
SKIP = 1.1  # cost of a pose without cloud, or a cloud without pose; a pair costs from 0 (it fits) to 3
UNTOLD = 0.4  # cost of a pair whose cloud does not say what it shows
ROUNDS = 3


@dataclass(frozen=True)
class Slot:
    """One exposure that the plan asks for. pose: index among the poses."""

    pose: int
    exposure: int


@dataclass(frozen=True)
class CloudAssignment:
    """Which cloud belongs to which slot of a run.

    Attributes
    ----------
    cloud : tuple[int or None, ...]
        For each slot the index of its cloud, or None.
    spare : tuple[int, ...]
        Clouds without slot.
    moved : dict[int, int or None]
        Clouds that fit their slot only out of order (index of the cloud -> index of the slot where its order would put it, or None).
    distances : ndarray
        (C, P) mm, see PlacementFit.
    cost : float
        Mean cost of a slot.
    near_mm : float
        How far a cloud may be from its pose.
    """

    cloud: tuple[int | None, ...]
    spare: tuple[int, ...]
    moved: dict[int, int | None]
    distances: np.ndarray
    cost: float
    near_mm: float


def assign(fit: PlacementFit, clouds: Sequence[FoundCloud], slots: Sequence[Slot]) -> CloudAssignment:
    """Pair clouds in their order with the slots in theirs; a cloud or a slot may stay alone. ``fit`` learns from the pairs."""
    near = FAR_MM
    pairs: list[int | None] = []
    cost, distances = np.inf, np.zeros((len(clouds), len(fit.poses)))
    for _ in range(ROUNDS):
        distances = fit.distances(clouds)
        pairs, cost = _aligned(_costs(distances, slots, near), len(clouds), len(slots))
        fit.fit(clouds, _pose_of_cloud(pairs, slots, len(clouds)))
        near = NEAR_MM
    distances = fit.distances(clouds)
    each = [distances[c, slot.pose] for slot, c in zip(slots, pairs, strict=True) if c is not None and not np.isnan(distances[c, 0])]
    near = float(np.clip(NEAR_TIMES * np.median(each), LEAST_NEAR_MM, NEAR_MM)) if each else NEAR_MM
    pairs, cost = _aligned(_costs(distances, slots, near), len(clouds), len(slots))
    pairs, moved = _out_of_order(pairs, distances, slots, near)
    used = {c for c in pairs if c is not None}
    spare = tuple(c for c in range(len(clouds)) if c not in used)
    return CloudAssignment(tuple(pairs), spare, moved, distances, cost / max(len(slots), 1), near)


def _pose_of_cloud(pairs: Sequence[int | None], slots: Sequence[Slot], n: int) -> list[int | None]:
    out: list[int | None] = [None] * n
    for slot, cloud in zip(slots, pairs, strict=True):
        if cloud is not None:
            out[cloud] = slot.pose
    return out


def _costs(distances: np.ndarray, slots: Sequence[Slot], near_mm: float) -> np.ndarray:
    """(C, S) cost of a pair."""
    each = np.minimum(np.nan_to_num(distances, nan=np.inf, posinf=np.inf) / near_mm, 3.0)
    each = np.where(np.isnan(distances), UNTOLD, each)
    return each[:, [slot.pose for slot in slots]]


def _aligned(cost: np.ndarray, clouds: int, slots: int) -> tuple[list[int | None], float]:
    """The cheapest pairs that keep both orders: for each slot its cloud or None, and the whole cost."""
    best = np.zeros((clouds + 1, slots + 1))
    best[:, 0], best[0] = SKIP * np.arange(clouds + 1), SKIP * np.arange(slots + 1)
    step = np.zeros((clouds + 1, slots + 1), dtype=np.int8)
    step[1:, 0], step[0, 1:] = 1, 2
    for c in range(1, clouds + 1):
        for s in range(1, slots + 1):
            options = (best[c - 1, s - 1] + cost[c - 1, s - 1], best[c - 1, s] + SKIP, best[c, s - 1] + SKIP)
            step[c, s] = k = min(range(3), key=options.__getitem__)
            best[c, s] = options[k]
    pairs: list[int | None] = [None] * slots
    c, s = clouds, slots
    while c or s:
        k = step[c, s]
        if k == 0:
            pairs[s - 1] = c - 1
        c, s = c - (k != 2), s - (k != 1)
    return pairs, float(best[clouds, slots])


def _out_of_order(
    pairs: list[int | None], distances: np.ndarray, slots: Sequence[Slot], near_mm: float
) -> tuple[list[int | None], dict[int, int | None]]:
    """Give clouds that fit a free slot to it although others stand between; a cloud in a slot that it does not fit counts as free."""
    pairs = list(pairs)
    ill = [s for s, c in enumerate(pairs) if c is not None and not np.isnan(distances[c, 0]) and distances[c, slots[s].pose] > near_mm]
    place: dict[int, int | None] = {pairs[s]: s for s in ill}  # type: ignore[misc]
    for s in ill:
        pairs[s] = None
    used = {c for c in pairs if c is not None}
    free = [c for c in range(len(distances)) if c not in used and not np.isnan(distances[c, 0])]
    empty = [s for s, c in enumerate(pairs) if c is None]
    moved: dict[int, int | None] = {}
    options = sorted((distances[c, slots[s].pose], c, s) for c in free for s in empty)
    for distance, c, s in options:
        if distance > near_mm or c in moved or pairs[s] is not None:
            continue
        pairs[s], moved[c] = c, place.get(c)
    for s in ill:  # what fits nowhere stays where its order puts it: the checks of the run judge it
        c = next(c for c, where in place.items() if where == s)
        if c not in moved and pairs[s] is None:
            pairs[s] = c
    return _between(pairs, len(distances)), moved


def _between(pairs: list[int | None], clouds: int) -> list[int | None]:
    """Pair what is left where as many clouds as slots stand between the same neighbours: an artefact that was moved fits no pose."""
    pairs, used = list(pairs), {c for c in pairs if c is not None}
    s = 0
    while s < len(pairs):
        if pairs[s] is not None:
            s += 1
            continue
        end = next((k for k in range(s, len(pairs)) if pairs[k] is not None), len(pairs))
        first = -1 if s == 0 else pairs[s - 1]
        last = clouds if end == len(pairs) else pairs[end]
        left = [c for c in range((-1 if first is None else first) + 1, clouds if last is None else last) if c not in used]
        if len(left) == end - s:
            pairs[s:end] = left
            used |= set(left)
        s = end
    return pairs
