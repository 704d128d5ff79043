"""Which ball is which: the largest set of fitted spheres whose distances agree with the certificate.

A pair (found i, certified a) is a node; two nodes agree if the measured distance equals the certified one within tolerance. The
largest cliques are the possible assignments; a rigid fit with a free scale then separates them, and mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.spheres.found import SphereOptions

MAX_CLIQUES = 200
DECISIVE = 25.0


@dataclass(frozen=True)
class Assignment:
    """found, certified: index pairs (k,); rms: mm after a rigid fit with free scale; mirrored: rms of the fit with a reflection."""

    found: np.ndarray
    certified: np.ndarray
    rms: float
    mirrored: float


def assignments(centres: np.ndarray, sigma: np.ndarray, allowed: np.ndarray, known: np.ndarray, options: SphereOptions) -> list[Assignment]:
    """All largest assignments of fitted centres (k, 3) to known ones (B, 3), best rms first.

    sigma: (k,) mm uncertainty of each centre. allowed: (k, B) bool, which may be which (diameter, expectation).
    """
    found, ball = np.nonzero(allowed)
    if len(found) == 0:
        return []
    D_found = np.linalg.norm(centres[:, None] - centres, axis=2)
    D_ball = np.linalg.norm(known[:, None] - known, axis=2)
    wanted = D_ball[np.ix_(ball, ball)]
    tolerance = options.centre_tolerance + options.scale_tolerance * wanted + 5 * np.hypot(sigma[found][:, None], sigma[found])
    agree = np.abs(D_found[np.ix_(found, found)] - wanted) < tolerance
    agree &= (found[:, None] != found) & (ball[:, None] != ball)
    result = []
    for clique in _largest_cliques(agree):
        i, a = found[clique], ball[clique]
        result.append(Assignment(i, a, similarity_rms(known[a], centres[i]), similarity_rms(known[a], centres[i], mirror=True)))
    return sorted(result, key=lambda x: x.rms)


def size_classes(radii: np.ndarray, tolerance: float) -> np.ndarray:
    """(B,) for each certified radius (B,) the mean of those that a scan cannot tell from it: neighbours within ``tolerance``, relative.

    A certificate gives each ball its own measured diameter; balls that were bought as one size are sought and named as one size.
    """
    order = np.argsort(radii)
    apart = np.diff(radii[order]) > tolerance * radii[order][:-1]
    number = np.empty(len(radii), dtype=int)
    number[order] = np.concatenate([[0], np.cumsum(apart)])
    return np.array([radii[number == k].mean() for k in number])


def similarity_rms(source: np.ndarray, target: np.ndarray, mirror: bool = False) -> float:
    """Rms distance (mm) after the best rotation, translation and scale taking source (k, 3) to target (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.linalg.det(u) * np.linalg.det(vt) * (-1.0 if mirror else 1.0)
    s = s * np.array([1.0, 1.0, np.sign(sign) or 1.0])
    size = float(np.sum(a * a))
    rest = float(np.sum(b * b)) - (float(s.sum()) ** 2 / size if size > 0 else 0.0)
    return float(np.sqrt(max(rest, 0.0) / len(a)))


def decided(best: Assignment, other: Assignment, sigma: float) -> bool:
    """Whether the data prefer one assignment of the same size to another decisively; sigma mm of a centre, all causes."""
    return len(best.found) * (other.rms**2 - best.rms**2) / sigma**2 > DECISIVE


def prediction_distance(assignment: Assignment, centres: np.ndarray, predicted: np.ndarray) -> float:
    """Rms distance (mm) to the predicted places (B, 3, NaN unknown), a shift common to all counting only in part."""
    shift = centres[assignment.found] - predicted[assignment.certified]
    if not np.isfinite(shift).all():
        return np.inf
    common = shift.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum((shift - common) ** 2, axis=1)) + 0.1 * common @ common))


def _largest_cliques(agree: np.ndarray) -> list[list[int]]:
    """All maximum cliques of a graph (n, n) bool, at most MAX_CLIQUES (Bron-Kerbosch with pivoting, on bit masks)."""
    n = len(agree)
    neighbours = [int.from_bytes(np.packbits(row, bitorder="little").tobytes(), "little") for row in agree]
    best: list[list[int]] = []
    largest = 1

    def grow(clique: list[int], open_: int, closed: int) -> None:
        nonlocal best, largest
        if len(clique) + open_.bit_count() < largest or len(best) >= MAX_CLIQUES and len(clique) + open_.bit_count() <= largest:
            return
        if not open_:
            if not closed and len(clique) >= largest:
                best = [*(best if len(clique) == largest else []), clique]
                largest = len(clique)
            return
        pivot = max(_bits(open_ | closed), key=lambda v: (open_ & neighbours[v]).bit_count())
        for v in _bits(open_ & ~neighbours[pivot]):
            grow([*clique, v], open_ & neighbours[v], closed & neighbours[v])
            open_ &= ~(1 << v)
            closed |= 1 << v

    grow([], (1 << n) - 1, 0)
    return best


def _bits(mask: int):
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low
