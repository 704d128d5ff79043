"""Surfaces of triangles in files (STL, PLY, OBJ, OFF), read by Open3D once their heads were checked."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import kind_of
from mbcacq.files.open3d_library import open3d
from mbcacq.files.ply_header import read_header

SUFFIXES = (".stl", ".ply", ".obj", ".off")
MAX_BYTES = 2 << 30
_HEAD, _FACET = 84, 50  # bytes of a binary STL: its head with the number of triangles, and each of them


@dataclass(frozen=True)
class Mesh:
    """Triangles. vertices: (V, 3) in the file's unit; triangles: (T, 3) indices into them."""

    vertices: np.ndarray
    triangles: np.ndarray


def read_mesh(path: str | Path) -> Mesh:
    """The surface in a file. Raises ConfigError naming the file where it is absent, cut off, or holds no triangles."""
    path = Path(path)
    kind_of(path, SUFFIXES, "mesh", MAX_BYTES)
    announced = _announced_faces(path)
    found = open3d().io.read_triangle_mesh(str(path))
    vertices, triangles = np.asarray(found.vertices), np.asarray(found.triangles)
    if len(triangles) < announced:
        raise ConfigError(f"{path}: {len(triangles)} of its {announced} faces can be read; save the mesh anew")
    a, b, c = vertices[triangles].swapaxes(0, 1)
    triangles = triangles[np.any(np.cross(b - a, c - a), axis=1)]  # those that have a normal
    if not len(triangles) or not np.isfinite(vertices).all():
        raise ConfigError(f"{path}: holds no triangles with an area, or corners that are no finite numbers; save the mesh anew")
    return Mesh(vertices, triangles)


def _announced_faces(path: Path) -> int:
    """How many faces an STL or PLY file announces, 0 for other kinds. Raises ConfigError if the file is shorter than that."""
    if path.suffix.lower() == ".ply":
        return sum(element.count for element in read_header(path).elements if element.name == "face")
    if path.suffix.lower() != ".stl":
        return 0
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= _HEAD else 0
    if data[:5].lower() == b"solid" and len(data) != _HEAD + _FACET * count:
        if b"endsolid" not in data[-200:].lower():
            raise ConfigError(f"{path}: is cut off (no 'endsolid' at its end); save the mesh anew")
        corners = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        try:
            return len(np.array(corners, dtype=float)) // 3
        except ValueError:
            raise ConfigError(f"{path}: a corner of its triangles has no three numbers; save the mesh anew") from None
    if len(data) < _HEAD + _FACET * count or not count:
        raise ConfigError(f"{path}: is cut off: its head announces {count} triangles; save the mesh anew")
    return count
