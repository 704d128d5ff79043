"""Sphere of known radius through noisy points: Gauss-Newton on the geometric distance, with Tukey's weights.

``f_i = |p_i - c| - R`` and ``df/dc = -u_i``, u the unit vector from the centre to the point. The weights fall to zero at
TUKEY times the noise, so that edge and background points have no say; symmetric, so that they do not bias what is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TUKEY = 6.0
NOISE_FLOOR_MM = 1e-4


@dataclass(frozen=True)
class SphereFit:
    """centre (3,) mm; covariance (3, 3) mm^2; noise_mm: estimated sigma of a point; rms_mm and n_points: of the points used.

    coverage: share of the cap within the limit of incidence that has points. radius_error, radius_sigma: mm, freely fitted minus given.
    cap: (3,) mean direction of the points used, not normalised.
    """

    centre: np.ndarray
    covariance: np.ndarray
    noise_mm: float
    rms_mm: float
    n_points: int
    coverage: float
    radius_error: float
    radius_sigma: float
    cap: np.ndarray


def rough_fit(points: np.ndarray, centre: np.ndarray, radius: float, max_noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Centre and mean direction (3,) of the visible cap, from at most a few hundred of the points."""
    few = points[:: max(1, len(points) // 400)]
    gate = 0.1 * radius
    u = np.zeros((1, 3))
    for step in range(8):
        offset = few - centre
        distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
        f = distance - radius
        near = np.abs(f) < gate
        if near.sum() < 8:
            return centre, np.zeros(3)
        u, f = offset[near] / distance[near, None], f[near]
        scale = min(max(1.4826 * np.median(np.abs(f)), NOISE_FLOOR_MM), max_noise if step > 3 else gate)
        w = _tukey(f / (TUKEY * scale))
        normal = (u * w[:, None]).T @ u + 1e-9 * np.eye(3)
        centre = centre + np.clip(np.linalg.solve(normal, u.T @ (w * f)), -gate, gate)
    return centre, (u * (w > 0)[:, None]).mean(axis=0)


def sphere_fit(points: np.ndarray, centre: np.ndarray, radius: float, view: np.ndarray, max_incidence: float,
               max_noise: float, iterations: int = 12) -> SphereFit | None:
    """Fit from a start within about a tenth of the radius. points: (n, 3) float64 mm. None where nothing is left to fit.

    view: (3,) unit vector towards the scanner; points seen at more than ``max_incidence`` rad are left out by their direction from
    the centre, which the noise along the normal cannot change.
    """
    limit = np.cos(max_incidence)
    gate = TUKEY * max_noise
    noise = max_noise
    for _ in range(iterations):
        offset = points - centre
        distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
        f = distance - radius
        use = (np.abs(f) < gate) & (offset @ view > limit * distance)
        if use.sum() < 8:
            return None
        u, f = offset[use] / distance[use, None], f[use]
        noise = float(np.clip(1.4826 * np.median(np.abs(f)), NOISE_FLOOR_MM, max_noise))
        gate = min(gate, 4 * TUKEY * noise)
        w = _tukey(f / (TUKEY * noise))
        normal = (u * w[:, None]).T @ u
        try:
            step = np.linalg.solve(normal, u.T @ (w * f))
        except np.linalg.LinAlgError:
            return None
        centre = centre + step
        if step @ step < 1e-12:
            break
    return _summary(centre, u, f - u @ step, w, normal, view, max_incidence)


def _summary(centre, u, f, w, normal, view, max_incidence) -> SphereFit:
    used = w > 0
    n = int(used.sum())
    total = float(w.sum())
    variance = float(w @ f**2) / max(total - 3, 1.0)
    covariance = variance * np.linalg.inv(normal + 1e-12 * np.eye(3))
    # one more Gauss-Newton step with the radius free: f + u dc - dR = 0
    free = np.zeros((4, 4))
    free[:3, :3], free[3, 3] = normal, total
    free[:3, 3] = free[3, :3] = u.T @ w
    inverse = np.linalg.inv(free + 1e-12 * np.eye(4))
    radius_error = float((inverse @ np.append(u.T @ (w * f), w @ f))[3])
    return SphereFit(centre, covariance, float(np.sqrt(variance)), float(np.sqrt(np.mean(f[used] ** 2))), n,
                     _coverage(u[used], view, max_incidence), radius_error, float(np.sqrt(variance * max(inverse[3, 3], 0.0))),
                     u[used].mean(axis=0))


def _coverage(u: np.ndarray, view: np.ndarray, max_incidence: float) -> float:
    """Share of the cells of the disk, as seen along ``view``, that hold a point; fewer cells where there are few points."""
    cells = int(np.clip(np.sqrt(len(u) / 4), 4, 12))
    side = np.cross(view, np.eye(3)[np.argmin(np.abs(view))])
    side /= np.linalg.norm(side)
    plane = np.stack([side, np.cross(view, side)], axis=1)
    disk = u @ plane / np.sin(max_incidence)
    index = np.clip(((disk + 1) * (cells / 2)).astype(int), 0, cells - 1)
    seen = np.zeros((cells, cells), dtype=bool)
    seen[index[:, 0], index[:, 1]] = True
    middle = (np.arange(cells) + 0.5) / (cells / 2) - 1
    inside = middle[:, None] ** 2 + middle**2 < 1
    return float(np.count_nonzero(seen & inside) / np.count_nonzero(inside))


def _tukey(t: np.ndarray) -> np.ndarray:
    inside = np.maximum(1.0 - t * t, 0.0)
    return inside * inside
