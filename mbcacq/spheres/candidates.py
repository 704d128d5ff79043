"""Where balls of a known radius could be: every patch votes for the two places one radius along its normal.

On a ball all votes meet in its centre; on a plate they lie in a sheet, on a rod along a line. So a ball is found also where it
touches a plate or another ball, which plain connectivity would not separate.
"""

from __future__ import annotations

import numpy as np

from mbcacq.spheres.voxels import Patches

MIN_VOTES = 6
CELL = 1 / 2.5  # edge of a cell of the histogram, in radii; a window has two along each axis
CORNER = 1.01 * np.sqrt(3.0) * CELL  # from the middle of a window to its corners, where all of its votes may lie


def sphere_candidates(patches: Patches, radius: float, view: np.ndarray | None, limit: int) -> tuple[np.ndarray, np.ndarray]:
    """Rough centres (k, 3) mm and their votes (k,), most votes first, at most ``limit``."""
    votes = _votes(patches, radius, view)
    if len(votes) < MIN_VOTES:
        return np.empty((0, 3)), np.empty(0, dtype=int)
    size = CELL * radius
    low = votes.min(axis=0) - size
    index = ((votes - low) / size).astype(np.int64)
    shape = index.max(axis=0) + 2
    if np.prod(shape) > 20_000_000:
        return np.empty((0, 3)), np.empty(0, dtype=int)
    histogram = np.bincount(np.ravel_multi_index(tuple(index.T), tuple(shape)), minlength=int(np.prod(shape))).reshape(shape)
    for axis in range(3):
        histogram = histogram + np.roll(histogram, -1, axis=axis)
    centres, counts = [], []
    for start, window in _peaks(histogram, limit * 3):
        # windows come fullest first; the rest are sheets of votes above plates
        if window < max(MIN_VOTES, 0.2 * max(counts, default=0)) or len(centres) == limit:
            break
        centre, count = _climb(votes, low + (np.array(start) + 1) * size, radius)
        new = all(np.linalg.norm(centre - other) > 0.7 * radius for other in centres)
        if new and count >= max(MIN_VOTES, 0.2 * max(counts, default=0)):
            centres.append(centre)
            counts.append(count)
    order = np.argsort(counts)[::-1][:limit]
    return np.array(centres).reshape(-1, 3)[order], np.array(counts, dtype=int)[order]


def _votes(patches: Patches, radius: float, view: np.ndarray | None) -> np.ndarray:
    # the centroid of a cap lies below its top by half its spread over the radius
    reach = np.maximum(radius - patches.spread / (2 * radius), 0.5 * radius)[:, None] * patches.normal
    if view is not None:
        return patches.centroid - np.sign(patches.normal @ view)[:, None] * reach
    return np.concatenate([patches.centroid - reach, patches.centroid + reach])


def _peaks(histogram: np.ndarray, limit: int):
    """Index and votes of the fullest windows, each blotting out its surroundings."""
    remaining = histogram.copy()
    for _ in range(limit):
        at = np.unravel_index(int(remaining.argmax()), remaining.shape)
        yield at, int(remaining[at])
        remaining[tuple(slice(max(i - 2, 0), i + 3) for i in at)] = 0


def _climb(votes: np.ndarray, centre: np.ndarray, radius: float) -> tuple[np.ndarray, int]:
    """Mean shift with a shrinking ball; the count is of the votes in the last one."""
    near = votes[np.all(np.abs(votes - centre) < radius, axis=1)]
    for reach in (CORNER, 0.4, 0.3, 0.25, 0.25):
        inside = np.sum((near - centre) ** 2, axis=1) < (reach * radius) ** 2
        if not inside.any():
            return centre, 0
        centre = near[inside].mean(axis=0)
    return centre, int(inside.sum())
