"""Rays at a surface of triangles, cast by Open3D; the places of the hits are computed in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.files.open3d_library import open3d
from mbcacq_fakes.world.rigid import carry, invert

_KNOWN: dict[int, tuple[np.ndarray, Any]] = {}  # surface -> scene; building one costs more than an exposure
LIFT_MM = 0.01  # of a ray to the lamp, from the surface on which it begins


def first_hits(
    triangles: np.ndarray, T: np.ndarray, foot: np.ndarray, along: np.ndarray, start_z: float
) -> tuple[np.ndarray, np.ndarray, Any]:
    """z (N,) mm of the first hit, -inf where none, outward normal (3, N), and the surface for ``shaded``.

    triangles: (T, 3, 3) mm, anticlockwise seen from outside, moved by T (4, 4) into the scanner frame. Rays are foot + z along, (3, N)
    each, and run down from ``start_z``.
    """
    surface, inverse = _surface(triangles), invert(T)
    rays = np.concatenate([carry(inverse, (foot + start_z * along).T), -along.T @ inverse[:3, :3].T], axis=1)
    found = surface.cast_rays(open3d().core.Tensor(rays.astype(np.float32)), nthreads=1)["primitive_ids"].numpy().astype(np.int64)
    hit = np.flatnonzero(found < len(triangles))
    corner = carry(T, triangles.reshape(-1, 3)).reshape(-1, 3, 3)
    plane = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    plane /= np.linalg.norm(plane, axis=1)[:, None]
    normal, z = np.zeros_like(foot), np.full(foot.shape[1], -np.inf)
    normal[:, hit] = plane[found[hit]].T
    away = corner[found[hit], 0].T - foot[:, hit]
    z[hit] = np.einsum("cn,cn->n", normal[:, hit], away) / np.einsum("cn,cn->n", normal[:, hit], along[:, hit])
    return z, normal, surface


def shaded(surface: Any, T: np.ndarray, xyz: np.ndarray, to_lamp: np.ndarray) -> np.ndarray:
    """(N,) bool: the surface itself stands between a place on it (3, N) mm and the lamp."""
    if not xyz.shape[1]:
        return np.zeros(0, bool)
    inverse, far = invert(T), np.linalg.norm(to_lamp, axis=0)
    rays = np.concatenate([carry(inverse, (xyz + LIFT_MM * to_lamp / far).T), (to_lamp / far).T @ inverse[:3, :3].T], axis=1)
    return surface.test_occlusions(open3d().core.Tensor(rays.astype(np.float32)), nthreads=1).numpy()


def _surface(triangles: np.ndarray) -> Any:
    known = _KNOWN.get(id(triangles))
    if known is None or known[0] is not triangles:
        o3d = open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        corners, index = triangles.reshape(-1, 3).astype(np.float32), np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
        scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(index))
        _KNOWN[id(triangles)] = triangles, scene
    return _KNOWN[id(triangles)][1]
