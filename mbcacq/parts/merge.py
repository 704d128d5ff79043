"""One cloud of all scans of a part: in each voxel the point stays that is known best. Nothing is averaged or smoothed.

Scans are read one at a time and their points put into blocks on the disk; blocks are thinned one at a time, and each in pieces. So memory
does not grow with the number of scans.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import replacing
from mbcacq.files.open3d_library import open3d
from mbcacq.files.ply_header import read_header
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import cells_of
from mbcacq.parts.placement import CHUNK, CellPlacement, CommonMotion
from mbcacq.parts.scans import Scans, ScanSurface, surface_of
from mbcacq.spheres.ply import ply_header

# A point of the merged cloud. sigma_mm, sigma_base_mm: standard uncertainty along its normal, by the cell, the joints and the scanner,
# within the part and in the base frame. scan: number of its pose.
POINT = np.dtype([(n, "<f4") for n in ("x", "y", "z", "nx", "ny", "nz", "sigma_mm", "sigma_base_mm")] + [("scan", "<u4")])


@dataclass(frozen=True)
class Merged:
    """What was written: number of points before and after thinning, of scans, and the median and largest sigma_mm along the normal."""

    read: int
    kept: int
    scans: int
    sigma_mm: float
    worst_mm: float


def merge(
    scans: Scans,
    placement: CellPlacement,
    common: CommonMotion,
    noise_mm: tuple[float, float],
    voxel_mm: float,
    out: Path,
    options: PartOptions,
    simulated: bool = False,
) -> Merged:
    """Write the merged cloud as binary PLY, base frame, mm.

    noise_mm: of a point of one scan that is seen straight on, by itself and together with its neighbours. Raises RecordingError.
    """
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".merge-") as folder:
        blocks = _Blocks(Path(folder), voxel_mm, options)
        count = 0
        for scan in scans():
            surface = surface_of(scan)
            for start in range(0, len(surface.points), CHUNK):
                piece = slice(start, start + CHUNK)
                some = replace(surface, points=surface.points[piece], normals=surface.normals[piece])
                blocks.add(_points(some, placement, common, noise_mm))
            count += 1
        kept, sigma = 0, []
        body = Path(folder) / "body"
        with body.open("wb") as file:
            for points in blocks.thinned():
                file.write(points.tobytes())
                kept += len(points)
                sigma.append(np.quantile(points["sigma_mm"], [0.5, 1.0]))
        with replacing(out) as partial, partial.open("wb") as file:
            file.write(ply_header({name: POINT[name] for name in POINT.names or ()}, kept, ["simulated: true"] if simulated else ()))
            with body.open("rb") as source:
                while piece := source.read(1 << 22):
                    file.write(piece)
    middle, worst = np.array(sigma).T
    return Merged(blocks.read, kept, count, float(np.median(middle)), float(worst.max()))


def merged_points(path: Path) -> np.ndarray:
    """The points of a cloud that ``merge`` wrote, as ``POINT``, read from the disk as they are used. Raises ConfigError for another."""
    header = read_header(path)
    if [p.name for p in header.elements[0].properties] != list(POINT.names or ()):
        raise ConfigError(f"{path} is no cloud that mbcacq merge wrote; merge the scans again")
    return np.memmap(path, POINT, "r", header.size, (header.elements[0].count,))


def _points(surface: ScanSurface, placement: CellPlacement, common: CommonMotion, noise_mm: tuple[float, float]) -> np.ndarray:
    """The points of a scan as ``POINT``."""
    single, together = noise_mm
    out = np.empty(len(surface.points), POINT)
    normals = surface.normals @ placement.frame(surface.q)[:3, :3].T
    seen = (single / surface.facing) ** 2 + together**2
    for name, moved in (("sigma_mm", common), ("sigma_base_mm", None)):
        known = placement.covariance_over(surface.q, surface.points, moved).variance_along(surface.points, normals)
        out[name] = np.sqrt(known + seen)
    out["scan"] = surface.number
    for name, values in zip(POINT.names or (), [*placement.to_base(surface.q, surface.points).T, *normals.T], strict=False):
        out[name] = values
    return out


class _Blocks:
    """Points by blocks of space, in files. A block is as large as voxels of it with ``options.block_points`` points may be."""

    def __init__(self, folder: Path, voxel_mm: float, options: PartOptions) -> None:
        self._folder, self._voxel, self._most, self.read = folder, voxel_mm, options.block_points, 0
        self._edge = voxel_mm * max(1, int((options.block_points / 10) ** 0.5))  # of a surface seen by ten scans

    def add(self, points: np.ndarray) -> None:
        self.read += len(points)
        key = cells_of(xyz_of(points), self._edge)
        order = np.argsort(key, kind="stable")
        block, start = np.unique(key[order], return_index=True)
        for name, some in zip(block.tolist(), np.split(points[order], start[1:]), strict=True):
            with (self._folder / f"block-{name}").open("ab") as file:
                file.write(some.tobytes())

    def thinned(self) -> Iterator[np.ndarray]:
        """Block by block, of each voxel its best known point."""
        for path in sorted(self._folder.glob("block-*")):
            best = np.empty(0, POINT)
            with path.open("rb") as file:
                while len(some := np.fromfile(file, POINT, self._most)):
                    points = np.concatenate([best, some])
                    voxel = cells_of(xyz_of(points), self._voxel)
                    order = np.lexsort((points["sigma_mm"], voxel))
                    first = np.unique(voxel[order], return_index=True)[1]
                    best = points[np.sort(order[first])]
            yield best
            path.unlink()


def xyz_of(points: np.ndarray) -> np.ndarray:
    """(N, 3) mm of points of a merged cloud."""
    return np.stack([points[axis] for axis in "xyz"], axis=1).astype(float)


def surface_mesh(cloud: Path, out: Path, depth: int = 9) -> int:
    """Write the surface through a merged cloud (screened Poisson, Kazhdan and Hoppe 2013) as STL; the number of its triangles."""
    o3d = open3d()
    points = o3d.io.read_point_cloud(str(cloud))
    mesh, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(points, depth=depth, n_threads=1)
    thin = np.asarray(density) < np.quantile(np.asarray(density), 0.02)  # what the method adds beyond the edges of the scans
    mesh.remove_vertices_by_mask(thin)
    mesh.compute_triangle_normals()
    o3d.io.write_triangle_mesh(str(out), mesh)
    return len(mesh.triangles)
