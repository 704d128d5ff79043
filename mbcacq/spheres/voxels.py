"""A cloud as small flat patches: points are put into cubes, each cube gives a centroid and a normal.

It takes one pass over the points; everything after it works on a few thousand patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.errors import DeviceFault

MAX_DENSE_CELLS = 4_000_000
POINTS_PER_PATCH = 24
MIN_PATCH_POINTS = 5


@dataclass(frozen=True)
class Voxels:
    """Occupied cubes of a cloud. cell: (N,) index into the cubes of each point; corner: (m, 3) mm; size mm; count: (m,)."""

    cell: np.ndarray
    corner: np.ndarray
    size: float
    count: np.ndarray


@dataclass(frozen=True)
class Patches:
    """Cubes flat enough to have a normal. centroid, normal: (p, 3); spread: (p,) mm^2, sum of the two in-plane variances."""

    centroid: np.ndarray
    normal: np.ndarray
    spread: np.ndarray


def voxelise(columns: np.ndarray, size: float) -> Voxels:
    """Sort finite points, given as columns (3, N), into cubes of edge ``size``."""
    low = columns.min(axis=1).astype(np.float64)
    extent = (columns.max(axis=1) - low) / size
    if not np.all(extent < 2**20):
        widest = 1e-3 * size * float(extent.max())
        raise DeviceFault(f"the scan is {widest:.3g} m wide, no field of view is; take it again, or look at the scanner's resolution")
    shape = extent.astype(np.int64) + 1
    dense = np.prod(shape) <= MAX_DENSE_CELLS
    index = np.int32 if dense else np.int64
    scale = columns.dtype.type(1.0 / size)
    key = np.zeros(columns.shape[1], dtype=index)
    for axis in range(3):
        place = columns[axis] - columns.dtype.type(low[axis])
        place *= scale
        key *= index(shape[axis])
        key += np.minimum(place.astype(index), index(shape[axis] - 1))
    if dense:
        total = np.bincount(key, minlength=int(np.prod(shape)))
        occupied = np.flatnonzero(total)
        number = np.zeros(len(total), dtype=np.int32)
        number[occupied] = np.arange(len(occupied), dtype=np.int32)
        cell, count = number[key], total[occupied]
    else:
        occupied, cell, count = np.unique(key, return_inverse=True, return_counts=True)
    corner = np.stack(np.unravel_index(occupied, tuple(shape)), axis=1) * size + low
    return Voxels(cell.astype(np.int32, copy=False), corner, size, count)


def patches(columns: np.ndarray, voxels: Voxels) -> Patches:
    """Centroid and normal of the cubes whose points are flat; the densest clouds are thinned first."""
    from scipy.sparse import csc_array

    typical = np.sort(voxels.count)[len(voxels.count) // 2 :]
    stride = max(1, int(typical[0] // POINTS_PER_PATCH))
    cell = voxels.cell[::stride]
    n, m, kind = len(cell), len(voxels.count), columns.dtype.type
    middle = (voxels.corner + voxels.size / 2).T.astype(kind)
    x, y, z = (columns[axis, ::stride] - middle[axis][cell] for axis in range(3))
    moments = np.empty((n, 10), dtype=kind)
    for j, column in enumerate((kind(1), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x)):
        moments[:, j] = column
    gather = csc_array((np.ones(n, kind), cell, np.arange(n + 1, dtype=np.int32)), shape=(m, n))
    total = (gather @ moments).astype(np.float64)
    keep = total[:, 0] >= MIN_PATCH_POINTS
    total = total[keep] / total[keep, :1]
    mean = total[:, 1:4]
    xx, yy, zz = (total[:, 4:7] - mean**2).T
    xy, yz, zx = (total[:, 7:10] - mean * np.roll(mean, -1, axis=1)).T
    values, normal = smallest_eigenvector(xx, yy, zz, xy, yz, zx)
    flat = (values[:, 0] < 0.12 * values[:, 1]) & (values[:, 1] > 0.04 * values[:, 2])
    centroid = mean + voxels.corner[keep] + voxels.size / 2
    return Patches(centroid[flat], normal[flat], values[flat, 1] + values[flat, 2])


def smallest_eigenvector(xx, yy, zz, xy, yz, zx) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (m, 3), ascending, and unit eigenvector (m, 3) of the smallest, of symmetric 3 x 3 matrices, in closed form."""
    middle = (xx + yy + zz) / 3
    a, b, c = xx - middle, yy - middle, zz - middle
    radius = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + yz * yz + zx * zx)) / 6) + 1e-100
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * zx) + zx * (xy * yz - b * zx)) / (2 * radius**3)
    angle = np.arccos(np.clip(half, -1.0, 1.0)) / 3
    largest = middle + 2 * radius * np.cos(angle)
    smallest = middle + 2 * radius * np.cos(angle + 2 * np.pi / 3)
    values = np.stack([smallest, 3 * middle - largest - smallest, largest], axis=1)
    rows = np.stack([np.stack([xx - smallest, xy, zx], 1), np.stack([xy, yy - smallest, yz], 1), np.stack([zx, yz, zz - smallest], 1)])
    products = np.stack([np.cross(rows[0], rows[1]), np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0])], axis=1)
    length = np.linalg.norm(products, axis=2)
    best = length.argmax(axis=1)
    each = np.arange(len(best))
    return values, products[each, best] / (length[each, best] + 1e-300)[:, None]
