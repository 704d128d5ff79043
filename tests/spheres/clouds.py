"""Clouds with a known truth, by intersecting a fan of rays with spheres and planes in closed form."""

from __future__ import annotations

import numpy as np

from mbcacq.model.cell import Artefact

EYE = np.array([0.0, 0.0, 420.0])


def artefact(seed: int = 3, n: int = 8, diameter: float = 12.0, name: str = "mbc") -> Artefact:
    """Balls scattered in a flat box, at least two diameters apart."""
    rng = np.random.default_rng(seed)
    centres: list[np.ndarray] = []
    while len(centres) < n:
        c = rng.uniform([-42, -42, -8], [42, 42, 8])
        if all(np.linalg.norm(c - o) > 1.8 * diameter for o in centres):
            centres.append(c)
    return make(np.array(centres), diameter, name)


def make(centres: np.ndarray, diameter: float | np.ndarray = 12.0, name: str = "mbc", first: int = 1) -> Artefact:
    ids = tuple(range(first, first + len(centres)))
    return Artefact(name, name, ids, np.asarray(centres, float), np.broadcast_to(np.asarray(diameter, float), (len(centres),)).copy())


def rotation(axis, angle_deg: float) -> np.ndarray:
    k = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    a = np.radians(angle_deg)
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


def scan(
    rng: np.random.Generator,
    centres: np.ndarray,
    diameters,
    *,
    noise: float = 0.01,
    spacing: float = 0.25,
    half: float = 60.0,
    plate_z: float | None = -25.0,
    edges: float = 0.03,
    drop: float = 0.02,
    plate_tilt: float = 0.0,
) -> np.ndarray:
    """(N, 3) float32 of what a camera at EYE sees of balls (k, 3) over a plate: noise along the rays, mixed points at the rims."""
    grid = np.arange(-half, half, spacing)
    target = np.stack([*np.meshgrid(grid, grid, indexing="ij"), np.zeros((len(grid), len(grid)))], -1).reshape(-1, 3)
    ray = target - EYE
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    depth = np.full(len(ray), np.inf)
    if plate_z is not None:
        normal = rotation([1, 0.3, 0], plate_tilt) @ [0, 0, 1.0]
        depth = ((np.array([0, 0, plate_z]) - EYE) @ normal) / (ray @ normal)
    on_ball = np.full(len(ray), -1)
    rim = np.zeros(len(ray), bool)
    background = depth.copy()
    for j, (c, d) in enumerate(zip(centres, np.broadcast_to(diameters, len(centres)), strict=True)):
        along = ray @ (c - EYE)
        miss2 = np.sum((c - EYE) ** 2) - along**2
        hit = miss2 < (d / 2) ** 2
        t = along - np.sqrt(np.where(hit, (d / 2) ** 2 - miss2, 0))
        nearer = hit & (t < depth)
        depth[nearer], on_ball[nearer] = t[nearer], j
        rim[nearer] = miss2[nearer] > (0.93 * d / 2) ** 2
    n_ball = int((on_ball >= 0).sum())
    mixed = rng.permutation(np.flatnonzero(rim))[: int(edges * n_ball)]
    far = np.where(np.isfinite(background), background, depth + 20)
    depth[mixed] += rng.uniform(0, 1, len(mixed)) * (far[mixed] - depth[mixed])
    keep = np.isfinite(depth) & (rng.uniform(size=len(depth)) > drop)
    depth = depth + rng.normal(0, noise, len(depth))
    return (EYE + depth[keep, None] * ray[keep]).astype(np.float32)


def cap(
    rng: np.random.Generator,
    centre,
    diameter: float,
    n: int,
    *,
    max_angle_deg: float = 75.0,
    noise: float = 0.01,
    outliers: float = 0.0,
    view=(0, 0, 1.0),
) -> np.ndarray:
    """(n, 3) float64 on the side of a ball that faces ``view``, evenly in projection; one-sided outliers at the rim, away from the viewer."""
    view = np.asarray(view, float) / np.linalg.norm(view)
    s = np.sqrt(rng.uniform(0, np.sin(np.radians(max_angle_deg)) ** 2, n))
    phi = rng.uniform(0, 2 * np.pi, n)
    side = np.cross(view, [0.6, 0.8, 0.1])
    side /= np.linalg.norm(side)
    u = (s * np.cos(phi))[:, None] * side + (s * np.sin(phi))[:, None] * np.cross(view, side) + np.sqrt(1 - s**2)[:, None] * view
    points = np.asarray(centre) + (diameter / 2 + rng.normal(0, noise, n))[:, None] * u
    bad = rng.permutation(n)[: int(outliers * n)]
    bad = bad[np.argsort(-s[bad])]
    points[bad] -= rng.uniform(0.02, 1.0, (len(bad), 1)) * view
    return points
