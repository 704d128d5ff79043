"""Parsers of clouds: PLY, PCD, text, STL."""

from __future__ import annotations

import struct

import numpy as np
from fuzz_target import Target, in_file

from mbcacq.spheres.cloud_file import read_cloud_file
from mbcacq.spheres.cloud_files import read_points

PLY_HEAD = "ply\nformat {} 1.0\ncomment made\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
PLYS = (
    PLY_HEAD.format("ascii").encode() + b"0 0 0\n1 2.5 -3\n1e-3 4 5\n",
    PLY_HEAD.format("binary_little_endian").encode() + struct.pack("<9f", *range(9)),
    PLY_HEAD.format("binary_big_endian").encode() + struct.pack(">9f", *range(9)),
)
PCD_HEAD = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z rgb
SIZE 4 4 4 4
TYPE F F F F
COUNT 1 1 1 1
WIDTH 3
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 3
DATA {}
"""
_ROWS = np.arange(12, dtype="<f4").reshape(3, 4)


def _literally(data: bytes) -> bytes:
    """LZF of runs of literals alone, behind both sizes."""
    runs = b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))
    return struct.pack("<II", len(runs), len(data)) + runs


PCDS = (
    PCD_HEAD.format("ascii").encode() + b"0 0 0 1\n1 2.5 -3 1\n1e-3 4 5 1\n",
    PCD_HEAD.format("binary").encode() + _ROWS.tobytes(),
    PCD_HEAD.format("binary_compressed").encode() + _literally(_ROWS.T.tobytes()),
    # one zero byte, and 47 copies of the byte before: 7 + 38 + 2
    PCD_HEAD.format("binary_compressed").encode() + struct.pack("<II", 5, 48) + b"\x00\x00\xe0\x26\x00",
)
LINES = (b"x y z\n1 2 3\n4 5.5 6\n-7e-1 8 9\n", b"3\n1;2;3\n4;5;6\n7;8;9\n", b"// made\n1,5 2,5 3,5\n4,5 5,5 6,5\n")
STL_TEXT = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 2.5\nendloop\nendfacet\nendsolid a\n"
STL = b"made".ljust(80) + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 2.5, 0)


def cloud_targets() -> list[Target]:
    """All of them."""
    return [
        Target("cloud PLY", PLYS, in_file("c.ply", read_cloud_file)),
        Target("cloud PCD", PCDS, in_file("c.pcd", read_cloud_file)),
        Target("scan PCD", PCDS[:3], in_file("c.pcd", read_points)),
        Target("cloud text", LINES, in_file("c.xyz", read_points)),
        Target("cloud STL", (STL_TEXT, STL), in_file("c.stl", read_points)),
    ]
