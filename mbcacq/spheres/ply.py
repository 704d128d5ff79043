"""Ball centres from a cloud in a file, as another laboratory would send it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.lazy import open3d
from mbcacq.model.cell import Artefact
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import FoundSpheres, SphereOptions
from mbcacq.spheres.ply_header import check_header

MAX_BYTES = 4 * 2**30


def read_tensor_cloud(path: str | Path):
    """Open3D tensor point cloud of a PLY or PCD file. Raises ConfigError naming the file where it holds no points."""
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such cloud; give the PLY or PCD file of a scan")
    if path.suffix.lower() not in (".ply", ".pcd"):
        raise ConfigError(f"{path}: a cloud must be a .ply or .pcd file")
    if path.stat().st_size > MAX_BYTES:
        raise ConfigError(f"{path}: {path.stat().st_size / 2**30:.1f} GiB are too much for one cloud")
    if path.suffix.lower() == ".ply":
        check_header(path)
    o3d = open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        try:
            cloud = o3d.t.io.read_point_cloud(str(path))
        except RuntimeError as error:
            raise ConfigError(f"{path}: cannot be read as a cloud: {str(error).strip().splitlines()[-1]}") from error
    if "positions" not in cloud.point or not len(cloud.point.positions):
        raise ConfigError(f"{path}: holds no points, or is not a complete {path.suffix[1:].upper()} file")
    return cloud


def read_cloud(path: str | Path) -> np.ndarray:
    """Points (N, 3) mm of a PLY or PCD file (float32 or float64 as stored). Raises ConfigError naming the file."""
    return read_tensor_cloud(path).point.positions.numpy()


def centres_from_ply(
    path: str | Path,
    artefact: Artefact,
    *,
    expected: Sequence[int] | None = None,
    predicted: np.ndarray | None = None,
    options: SphereOptions | None = None,
) -> FoundSpheres:
    """``find_spheres`` on the cloud in a file (mm, scanner frame)."""
    return find_spheres(read_cloud(path), artefact, expected=expected, predicted=predicted, options=options)
