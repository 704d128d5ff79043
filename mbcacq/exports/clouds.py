"""Point clouds written as PLY with all properties of their points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbcacq.files.atomic_write import write_file
from mbcacq.spheres.ply import TYPES, ply_content

NORMALS = ("nx", "ny", "nz")


def write_cloud(path: Path, points: np.ndarray, properties: Mapping[str, np.ndarray], T: np.ndarray) -> tuple[str, ...]:
    """Binary PLY of points (N, 3) as float64 and their properties (N,) in the types they have; normals are rotated by ``T`` (4, 4).

    Returns the names of properties that PLY has no type for, which are written as double. Raises RecordingError.
    """
    columns = {axis: points[:, i].astype("<f8") for i, axis in enumerate("xyz")}
    columns |= {name: np.asarray(values) for name, values in properties.items()}
    if all(name in columns for name in NORMALS):
        normals = np.stack([columns[name] for name in NORMALS], axis=1).astype(float) @ T[:3, :3].T
        columns |= {name: normals[:, i].astype(columns[name].dtype) for i, name in enumerate(NORMALS)}
    others = tuple(name for name, values in columns.items() if values.dtype.str[1:] not in TYPES)
    columns |= {name: columns[name].astype("<f8") for name in others}
    write_file(path, ply_content(columns))
    return others
