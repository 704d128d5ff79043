"""Distances of scans along the normal, cell by cell of their overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np
from scipy.sparse import csr_array

from mbcacq.parts.options import PartOptions

_TERMS = 5  # of the shape of a cell: a quadric but for its height


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


@dataclass(frozen=True)
class SurfaceCells:
    """Cells of a surface that two scans or more share, base frame. A group is the points of one scan in one cell.

    Attributes
    ----------
    point, normal : ndarray
        (c, 3) mm and unit vectors.
    scatter : ndarray
        (c,) mm, of a point about the surface.
    cell, scan : ndarray
        (g,) numbers of the cell and of the scan of each group, in this order.
    height : ndarray
        (g,) mm, of a group over ``point`` along the normal.
    variance : ndarray
        (g,) mm^2 of it, by the scatter of the points: roughness of the surface, and the incidence.
    """

    point: np.ndarray
    normal: np.ndarray
    scatter: np.ndarray
    cell: np.ndarray
    scan: np.ndarray
    height: np.ndarray
    variance: np.ndarray

    def shared(self, count: int) -> np.ndarray:
        """(count, count) numbers of cells that two scans share."""
        at = csr_array((np.ones(len(self.cell), int), (self.scan, self.cell)), shape=(count, len(self.point)))
        return (at @ at.T).toarray()

    def groups(self, which: np.ndarray) -> SurfaceCells:
        """Some of the groups, by mask; cells that no two of these share go."""
        which = which & (np.bincount(self.cell[which], minlength=len(self.point)) > 1)[self.cell]
        kept, cell = np.unique(self.cell[which], return_inverse=True)
        cells = replace(self, point=self.point[kept], normal=self.normal[kept], scatter=self.scatter[kept], cell=cell)
        return replace(cells, scan=self.scan[which], height=self.height[which], variance=self.variance[which])

    def pair(self, i: int, j: int) -> Overlap:
        """The overlap of two scans."""
        a, b = (np.flatnonzero(self.scan == k) for k in (i, j))
        cells, first, second = np.intersect1d(self.cell[a], self.cell[b], assume_unique=True, return_indices=True)
        a, b = a[first], b[second]
        distance, variance = self.height[a] - self.height[b], self.variance[a] + self.variance[b]
        return Overlap(self.point[cells], self.normal[cells], distance, variance, self.scatter[cells])


def surface_cells(scans: Sequence[tuple[np.ndarray, np.ndarray]], edge: float, options: PartOptions) -> SurfaceCells:
    """Compare scans, each given as points and unit normals (N, 3) in the base frame.

    In each cell of edge ``edge`` mm all share the shape of one quadric over the tangential plane, and each has a height of its own. So
    neither curvature nor the places of the samples bias their distances.
    """
    count = len(scans)
    points, normals = (np.concatenate([scan[k] for scan in scans]) for k in range(2))
    key, cell = np.unique(cells_of(points, edge), return_inverse=True)
    group, of_group = np.unique(cell * count + np.repeat(np.arange(count), [len(scan[0]) for scan in scans]), return_inverse=True)
    enough = np.bincount(of_group) >= options.points_in_cell
    shared = np.bincount(group[enough] // count, minlength=len(key)) > 1
    enough &= shared[group // count]
    cells = np.cumsum(shared) - 1
    renumbered, inside = np.cumsum(enough) - 1, enough[of_group]
    group = group[enough]
    return _fitted(points[inside], normals[inside], renumbered[of_group[inside]], (cells[group // count], group % count), options)


def _fitted(
    points: np.ndarray, normals: np.ndarray, group: np.ndarray, numbers: tuple[np.ndarray, np.ndarray], options: PartOptions
) -> SurfaceCells:
    """group: (n,) of each point; numbers: (g,) cell and (g,) scan of each group."""
    cell_of, scan = numbers
    cell, m, g = cell_of[group], int(cell_of.max(initial=-1)) + 1, len(cell_of)
    total, in_group, groups = np.bincount(cell, minlength=m), np.bincount(group, minlength=g), np.bincount(cell_of, minlength=m)

    def sums(values: np.ndarray, of: np.ndarray, size: int) -> np.ndarray:
        columns = [np.bincount(of, column, size) for column in values.reshape(len(of), prod(values.shape[1:])).T]
        return np.stack(columns, axis=1).reshape(size, *values.shape[1:])

    middle, normal = sums(points, cell, m) / total[:, None], sums(normals, cell, m)
    length = np.linalg.norm(normal, axis=1)
    normal = normal / length[:, None]
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(normal, u)
    arm = points - middle[cell]
    size = np.sqrt(np.bincount(cell, np.einsum("nc,nc->n", arm, arm), m) / total)  # scales the terms to order 1
    x, y = (np.einsum("nc,nc->n", arm, axis[cell]) / size[cell] for axis in (u, v))
    terms = np.stack([x, y, x * x, x * y, y * y, np.einsum("nc,nc->n", arm, normal[cell])], axis=1)
    mean = sums(terms, group, g) / in_group[:, None]
    within = terms - mean[group]
    A, height = within[:, :_TERMS], within[:, _TERMS]
    N = np.stack([sums(A * column[:, None], cell, m) for column in A.T], axis=1)  # all products at once would be 25 numbers a point
    inverse = np.linalg.inv(N + 1e-9 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS))
    shape = np.einsum("mij,mj->mi", inverse, sums(A * height[:, None], cell, m))
    left = height - np.einsum("nk,nk->n", A, shape[cell])
    scatter = np.sqrt(np.bincount(cell, left**2, m) / np.maximum(total - groups - _TERMS, 1))
    slope = np.einsum("mk,mkc->mc", shape[:, :2] / size[:, None], np.stack([u, v], axis=1))
    tilted = normal - slope  # of the fitted surface, better than the mean of the points' normals
    factor = np.linalg.norm(tilted, axis=1)
    usual = np.median(scatter) if m else 0.0
    apart = (
        mean[:, :_TERMS] - (sums(mean[:, :_TERMS], cell_of, m) / groups[:, None])[cell_of]
    )  # where a scan shows another part of the cell
    lever = 2 * np.einsum("gi,gij,gj->g", apart, inverse[cell_of], apart)  # exact for the distance of two scans
    smooth = (length > 0.9 * total) & (scatter < options.rough * usual)
    # A cell of few points may scatter little by chance: no cell counts as smoother than half of them do.
    variance = (1 / in_group + lever) * (np.maximum(scatter, usual) / factor)[cell_of] ** 2
    high = (mean[:, _TERMS] - np.einsum("gk,gk->g", mean[:, :_TERMS], shape[cell_of])) / factor[cell_of]
    found = SurfaceCells(middle, tilted / factor[:, None], scatter, cell_of, scan, high, variance)
    return found.groups(smooth[cell_of] & (lever * in_group < 8))
