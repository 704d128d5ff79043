"""The free-form part of plans/part.yaml: a block whose upper side is a smooth surface of waves and a boss."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.files.open3d_library import open3d

SIZE_MM, CELLS = (180.0, 120.0), (36, 24)


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """z in mm of the upper side at x, y in mm, the middle of the part being 0, 0."""
    waves = 6 * np.sin(x / 23) * np.cos(y / 19) + 4 * np.sin((x + 2 * y) / 31)
    boss = 18 * np.exp(-(((x - 35) / 22) ** 2 + ((y + 15) / 18) ** 2)) - 10 * np.exp(-(((x + 40) / 26) ** 2 + ((y - 20) / 20) ** 2))
    return 40 + waves + boss


def part() -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) mm and triangles (T, 3) of the upper side and of a skirt down to z = 0."""
    x, y = np.meshgrid(*(np.linspace(-s / 2, s / 2, n + 1) for s, n in zip(SIZE_MM, CELLS, strict=True)), indexing="ij")
    top = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    index = np.arange(len(top)).reshape(x.shape)
    a, b, c, d = (index[s].ravel() for s in (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]))
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])  # anticlockwise from above
    foot, after = len(top) + np.arange(len(rim)), np.roll(np.arange(len(rim)), -1)
    sides = [np.stack([foot, foot[after], rim[after]], 1), np.stack([foot, rim[after], rim], 1)]
    return np.vstack([top, top[rim] * [1, 1, 0]]), np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1), *sides])


if __name__ == "__main__":
    o3d = open3d()
    vertices, triangles = part()
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    mesh.compute_triangle_normals()
    o3d.io.write_triangle_mesh(str(Path(__file__).parents[2] / "plans/parts/freeform.stl"), mesh)
