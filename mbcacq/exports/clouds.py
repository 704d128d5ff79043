"""Point clouds written as PLY with all properties of their points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbcacq.files.atomic_write import write_file

NORMALS = ("nx", "ny", "nz")
PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"}


def write_cloud(path: Path, points: np.ndarray, properties: Mapping[str, np.ndarray], T: np.ndarray) -> tuple[str, ...]:
    """Binary PLY of points (N, 3) as float64 and their properties (N,) in the types they have; normals are rotated by ``T`` (4, 4).

    Returns the names of properties that PLY has no type for, which are written as double. Raises RecordingError.
    """
    columns = {axis: points[:, i].astype("<f8") for i, axis in enumerate("xyz")}
    columns |= {name: np.asarray(values) for name, values in properties.items()}
    if all(name in columns for name in NORMALS):
        normals = np.stack([columns[name] for name in NORMALS], axis=1).astype(float) @ T[:3, :3].T
        columns |= {name: normals[:, i].astype(columns[name].dtype) for i, name in enumerate(NORMALS)}
    others = tuple(name for name, values in columns.items() if values.dtype.str[1:] not in PLY_TYPES)
    columns |= {name: columns[name].astype("<f8") for name in others}
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    rows = np.empty(len(points), dtype)
    for name, values in columns.items():
        rows[name] = values
    announced = "".join(f"property {PLY_TYPES[values.dtype.str[1:]]} {name}\n" for name, values in columns.items())
    header = f"ply\nformat binary_little_endian 1.0\ncomment unit mm\nelement vertex {len(points)}\n{announced}end_header\n"
    write_file(path, header.encode("ascii", "replace") + rows.tobytes())
    return others
