"""Scans of a part as they are compared: places of their points, and the normals there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from mbcacq.errors import ConfigError
from mbcacq.files.open3d_library import open3d

NEIGHBOURS = 16  # of a point, to which its normal is fitted
FEWEST_POINTS = 200  # of a scan that says anything


@dataclass(frozen=True)
class PartScan:
    """One scan.

    Attributes
    ----------
    number : int
        Number of its pose in the recording.
    q : ndarray
        (n,) rad, joint angles as the controller reports them.
    points : ndarray
        (N, 3) mm, scanner frame.
    """

    number: int
    q: np.ndarray
    points: np.ndarray


Scans = Callable[[], Iterator[PartScan]]  # reads them anew, one at a time: all of them need not fit into memory


@dataclass(frozen=True)
class ScanSurface(PartScan):
    """A scan with unit normals (N, 3) towards the scanner."""

    normals: np.ndarray

    @property
    def facing(self) -> np.ndarray:
        """(N,) cosine of the incidence; the scanner looks along its z axis."""
        return np.clip(self.normals[:, 2], 0.05, 1.0)


def surface_of(scan: PartScan) -> ScanSurface:
    """The scan with its normals. Raises ConfigError for a scan of too few points."""
    if len(scan.points) < FEWEST_POINTS:
        raise ConfigError(f"the scan of pose {scan.number} has {len(scan.points)} points; leave that pose out, or scan it again")
    points = np.ascontiguousarray(scan.points, dtype=np.float64)
    cloud = open3d().geometry.PointCloud(open3d().utility.Vector3dVector(points))
    cloud.estimate_normals(open3d().geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    normals = np.asarray(cloud.normals)
    return ScanSurface(scan.number, scan.q, points, normals * np.where(normals[:, 2:] < 0, -1.0, 1.0))


def thinned(surface: ScanSurface, most: int) -> ScanSurface:
    """At most about ``most`` of its points, spread evenly over their order."""
    every = max(1, -(-len(surface.points) // most))
    return replace(surface, points=surface.points[::every].copy(), normals=surface.normals[::every].copy())  # the whole is let go


def spacing(points: np.ndarray) -> float:
    """Median distance in mm of a point (N, 3) from its nearest neighbour."""
    return float(np.median(KDTree(points).query(points[:: max(1, len(points) // 300)], k=2)[0][:, 1]))
