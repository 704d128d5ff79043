"""Clouds in PLY files: ball centres from one that another laboratory sends, and the content of one that is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mbcacq.model.cell import Artefact
from mbcacq.spheres.cloud_file import in_mm, read_cloud_file
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import FoundSpheres

TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"}


def read_cloud(path: str | Path) -> np.ndarray:
    """Points (N, 3) of a PLY or PCD file, in mm where its header states a unit, else as stored. Raises ConfigError naming the file."""
    found = read_cloud_file(path)
    return in_mm(path, found, found.unit or "mm")


def centres_from_ply(path: str | Path, artefact: Artefact) -> FoundSpheres:
    """``find_spheres`` on the cloud in a file (mm, scanner frame)."""
    return find_spheres(read_cloud(path), artefact)


def ply_content(columns: Mapping[str, np.ndarray], comments: Sequence[str] = ()) -> bytes:
    """Binary PLY of vertices: columns (N,) by name, each of one of ``TYPES``, lengths in mm. Open3D's writer drops what is no float."""
    count = len(next(iter(columns.values())))
    header = ply_header({name: values.dtype for name, values in columns.items()}, count, comments)
    rows = np.empty(count, [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    return header + rows.tobytes()


def ply_header(columns: Mapping[str, np.dtype], count: int, comments: Sequence[str] = ()) -> bytes:
    """Header of ``count`` vertices in mm, little-endian."""
    said = "".join(f"comment {line}\n" for line in ("unit mm", *comments))
    announced = "".join(f"property {TYPES[kind.str[1:]]} {name}\n" for name, kind in columns.items())
    return f"ply\nformat binary_little_endian 1.0\n{said}element vertex {count}\n{announced}end_header\n".encode("ascii", "replace")
