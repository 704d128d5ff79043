"""Circles in the profiles of a line scanner: the section of its laser plane with a sphere, found among other points.

A profile is (n, 2) mm in the plane of the laser. The circle is fitted to the geometric distance ``f_i = |p_i - c| - r`` by Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.quantities import DEGREE

GATE = 5.0  # times the noise: points beyond are no points of the circle
LEAST_POINTS = 10
LEAST_ARC = 40.0 * DEGREE  # of a shorter one, centre and radius are one thing to the data
LEAST_SHARE = 0.7  # of the points between the first and the last on the circle: other arcs are put together of what is beside the sphere
TRIPLETS, ROUNDS = 120, 6
NOISE_FLOOR_MM = 1e-5


@dataclass(frozen=True)
class Circle:
    """centre (2,) and radius, mm; cofactor (3, 3): covariance of both for a noise of 1 mm a point; squares: sum of the squared distances
    of the n_points used, mm^2."""

    centre: np.ndarray
    radius: float
    cofactor: np.ndarray
    squares: float
    n_points: int


def circles_in(profiles: Sequence[np.ndarray], largest_radius: float) -> tuple[list[Circle | None], float]:
    """The circle of at most ``largest_radius`` mm in each profile, None if there is none, and the noise (mm) of one point, pooled."""
    found = [circle_in(profile, largest_radius) for profile in profiles]
    free = sum(c.n_points - 3 for c in found if c)
    squares = sum(c.squares for c in found if c)
    return found, max(float(np.sqrt(squares / free)) if free else 0.0, NOISE_FLOOR_MM)


def circle_in(points: np.ndarray, largest_radius: float) -> Circle | None:
    """The circle that most points (n, 2) mm are on; None if fewer than ``LEAST_POINTS`` are, or their arc is short."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < LEAST_POINTS:
        return None
    points = points[np.argsort(points[:, 0], kind="stable")]
    gate = GATE * max(_roughness(points[:, 1]), NOISE_FLOOR_MM)
    start = _most_agreed(points, gate, largest_radius)
    if start is None:
        return None
    x = start
    for _ in range(ROUNDS):
        use, jacobian, off = _equations(points, x, gate)
        if len(off) < LEAST_POINTS:
            return None
        x = x - np.linalg.lstsq(jacobian, off, rcond=None)[0]
    use, jacobian, off = _equations(points, x, gate)
    if len(off) < LEAST_POINTS or _arc(points[use] - x[:2]) < LEAST_ARC or _share(use) < LEAST_SHARE:
        return None
    return Circle(x[:2], float(x[2]), np.linalg.inv(jacobian.T @ jacobian), float(off @ off), len(off))


def _roughness(z: np.ndarray) -> float:
    """Noise of one point from third differences, which a smooth section hardly has: their median size, robust to steps. The squares of the
    weights 1, 3, 3, 1 add up to 20."""
    third = np.diff(z, 3)
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)) if len(third) else 0.0


def _most_agreed(points: np.ndarray, gate: float, largest_radius: float) -> np.ndarray | None:
    """x, z, radius of the circle through three points near to each other that most others lie on (RANSAC with fixed draws)."""
    rng = np.random.default_rng(0)
    first = rng.integers(0, len(points), size=TRIPLETS)
    # Up to and with the last equal one: a point so far out that a radius more is the same number has itself for a neighbour.
    low = np.searchsorted(points[:, 0], points[first, 0] - largest_radius)
    high = np.searchsorted(points[:, 0], points[first, 0] + largest_radius, side="right")
    a, b, c = points[first], points[rng.integers(low, high)], points[rng.integers(low, high)]
    M = 2 * np.stack([b - a, c - a], axis=1)
    right = np.stack([np.sum(b * b - a * a, axis=1), np.sum(c * c - a * a, axis=1)], axis=1)
    able = np.abs(np.linalg.det(M)) > 1e-9
    if not able.any():
        return None
    centre = np.linalg.solve(M[able], right[able][:, :, None])[:, :, 0]
    radius = np.linalg.norm(a[able] - centre, axis=1)
    off = np.abs(np.linalg.norm(points - centre[:, None], axis=2) - radius[:, None])
    agreed = (off < gate).sum(axis=1) * (radius < 1.1 * largest_radius)
    best = int(np.argmax(agreed))
    return np.r_[centre[best], radius[best]] if agreed[best] >= LEAST_POINTS else None


def _equations(points: np.ndarray, x: np.ndarray, gate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points count (n,), their rows (k, 3) by centre and radius, and their distances (k,) from the circle."""
    away = points - x[:2]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    off = distance - x[2]
    use = np.abs(off) < gate
    return use, np.column_stack([-away[use] / distance[use, None], -np.ones(int(use.sum()))]), off[use]


def _share(use: np.ndarray) -> float:
    """Share of the points (n,), in their order, that count between the first and the last that do."""
    at = np.flatnonzero(use)
    return len(at) / (at[-1] - at[0] + 1)


def _arc(away: np.ndarray) -> float:
    """rad from the first to the last of the points about the centre: all round less the largest gap."""
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    return float(2 * np.pi - np.diff(np.r_[angle, angle[0] + 2 * np.pi]).max(initial=0.0))
