"""Point clouds with all their attributes, read and written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbcacq.errors import RecordingError
from mbcacq.lazy import open3d
from mbcacq.spheres.ply import read_tensor_cloud


def read(path: str | Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (N, 3) and every other attribute of them by name. Raises ConfigError naming the file."""
    cloud = read_tensor_cloud(path)
    arrays = {name: cloud.point[name].numpy() for name in cloud.point}
    return arrays.pop("positions"), arrays


def write(path: Path, points: np.ndarray, more: Mapping[str, np.ndarray], T: np.ndarray) -> None:
    """Binary PLY with float64 positions; normals, if there are any, are rotated by ``T`` (4, 4). Raises RecordingError."""
    o3d = open3d()
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.ascontiguousarray(points, dtype=np.float64)))
    for name, values in more.items():
        values = values @ T[:3, :3].T.astype(values.dtype) if name == "normals" else values
        cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(values))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        if not path.parent.is_dir() or not o3d.t.io.write_point_cloud(str(path), cloud):
            raise RecordingError(f"{path}: the cloud cannot be written; check folder and space")
