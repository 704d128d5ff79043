"""Distances of two scans along the normal, cell by cell of their overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.parts.options import PartOptions

_TERMS = 7  # of a cell: a quadric of six coefficients, and the distance


@dataclass(frozen=True)
class Overlap:
    """Cells of the overlap of two scans, base frame.

    Attributes
    ----------
    point, normal : ndarray
        (c, 3) mm and unit vectors.
    distance : ndarray
        (c,) mm, of the first scan from the second along the normal.
    variance : ndarray
        (c,) mm^2 of ``distance``, by the scatter of the points in the cell: its roughness, and the incidence.
    scatter : ndarray
        (c,) mm, of a point about the surface.
    """

    point: np.ndarray
    normal: np.ndarray
    distance: np.ndarray
    variance: np.ndarray
    scatter: np.ndarray

    def __len__(self) -> int:
        return len(self.point)

    def some(self, which: np.ndarray) -> Overlap:
        """Some of its cells, by mask or index."""
        return Overlap(*(values[which] for values in vars(self).values()))


def cells_of(points: np.ndarray, edge: float) -> np.ndarray:
    """(N,) int64 key of the cell of each point (N, 3) mm; cells are cubes of the base frame."""
    index = np.floor(points / edge).astype(np.int64) + 2**20
    return (index[:, 0] << 42) | (index[:, 1] << 21) | index[:, 2]


def overlap(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], edge: float, options: PartOptions) -> Overlap:
    """Compare two scans, each given as points and unit normals (N, 3) in the base frame.

    In each cell of edge ``edge`` mm both share one quadric over the tangential plane, and the first may lie off it by a distance. So
    neither curvature nor the places of the samples bias the distance.
    """
    points, normals = (np.concatenate([x, y]) for x, y in zip(a, b, strict=True))
    first = np.arange(len(points)) < len(a[0])
    key, cell = np.unique(cells_of(points, edge), return_inverse=True)
    count = np.stack([np.bincount(cell[first], minlength=len(key)), np.bincount(cell[~first], minlength=len(key))])
    shared = np.flatnonzero((count >= options.points_in_cell).all(axis=0))
    if not len(shared):
        return Overlap(*(np.empty((0, 3)),) * 2, *(np.empty(0),) * 3)
    number = np.full(len(key), -1)
    number[shared] = np.arange(len(shared))
    inside = number[cell] >= 0
    cell, points, normals, first = number[cell][inside], points[inside], normals[inside], first[inside]
    return _fitted(points, normals, first, cell, len(shared), options)


def _fitted(points: np.ndarray, normals: np.ndarray, first: np.ndarray, cell: np.ndarray, m: int, options: PartOptions) -> Overlap:
    total = np.bincount(cell, minlength=m)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cell, column, m) for column in values.reshape(len(cell), -1).T], axis=1)

    middle, normal = sums(points) / total[:, None], sums(normals)
    length = np.linalg.norm(normal, axis=1)
    normal /= length[:, None]
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(normal, u)
    arm = points - middle[cell]
    size = np.sqrt(np.bincount(cell, np.einsum("nc,nc->n", arm, arm), m) / total)  # scales the terms to order 1
    x, y = (np.einsum("nc,nc->n", arm, axis[cell]) / size[cell] for axis in (u, v))
    height = np.einsum("nc,nc->n", arm, normal[cell])
    A = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, first - 0.5], axis=1)
    N = sums(A[:, :, None] * A[:, None, :]).reshape(m, _TERMS, _TERMS)
    scale = 1e-9 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS)
    inverse = np.linalg.inv(N + scale)
    coefficients = np.einsum("mij,mj->mi", inverse, sums(A * height[:, None]))
    left = height - np.einsum("nk,nk->n", A, coefficients[cell])
    scatter = np.sqrt(np.bincount(cell, left**2, m) / np.maximum(total - _TERMS, 1))
    slope = np.einsum("mk,mkc->mc", coefficients[:, 1:3] / size[:, None], np.stack([u, v], axis=1))
    tilted = normal - slope  # of the fitted surface, better than the mean of the points' normals
    factor = np.linalg.norm(tilted, axis=1)
    usual = np.median(scatter)
    smooth = (length > 0.9 * total) & (scatter < options.rough * usual) & (inverse[:, -1, -1] * total < 16 * 4)
    # A cell of few points may scatter little by chance: no cell counts as smoother than half of them do.
    variance = inverse[:, -1, -1] * np.maximum(scatter, usual) ** 2 / factor**2
    found = Overlap(middle, tilted / factor[:, None], coefficients[:, -1] / factor, variance, scatter)
    return found.some(smooth)
