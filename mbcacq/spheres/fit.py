"""Spheres of known radius through noisy points, several at once: Gauss-Newton on the geometric distance, with Tukey's weights.

``f_i = |p_i - c| - R`` and ``df/dc = -u_i``, u the unit vector from the centre to the point. The weights fall to zero at
TUKEY times the noise, so that edge and background points do not count; symmetric, so that they do not bias the remaining points.
Arrays are (k, 3, n): k spheres, points padded to the longest cloud.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

TUKEY = 6.0
# for Gaussian noise under these weights: share of the variance that the weighted mean square shows,
# and the variance of the centre over variance * inverse(normal matrix)
VARIANCE_SHARE = 0.8924
COVARIANCE_FACTOR = 0.9657
NOISE_FLOOR_MM = 1e-4
VIEW_ROUNDS, MAX_ROUNDS = 4, 20
MIN_POINTS = 8


@dataclass(frozen=True)
class SphereFit:
    """centre (3,) mm; covariance (3, 3) mm^2; noise_mm: estimated sigma of a point; rms_mm and n_points: of the points used.

    coverage: share of the cap within the limit of incidence that has points. radius_error, radius_sigma: mm, freely fitted minus given.
    """

    centre: np.ndarray
    covariance: np.ndarray
    noise_mm: float
    rms_mm: float
    n_points: int
    coverage: float
    radius_error: float
    radius_sigma: float


@dataclass(frozen=True)
class _State:
    """One Gauss-Newton step of all spheres: directions u (k, 3, n), distances f (k, n), weights w (k, n), normal (k, 3, 3),
    step (k, 3), noise (k,) mm. Valid until the next step."""

    u: np.ndarray
    f: np.ndarray
    w: np.ndarray
    normal: np.ndarray
    step: np.ndarray
    noise: np.ndarray


def rough_fits(clouds: Sequence[np.ndarray], centres: np.ndarray, radii: np.ndarray, max_noise: float) -> np.ndarray:
    """Centres (k, 3), good to some micrometres, from a few hundred points (n, 3) of each cloud."""
    work = _Work([p[:: max(1, len(p) // 250)] for p in clouds])
    wide = 0.1 * radii
    for round_ in range(7):
        ceiling = np.maximum(wide * 0.4**round_, max_noise)
        state = work.step(centres, radii, np.minimum(wide, 3 * ceiling), ceiling, None, None, -1.0)
        centres = centres + np.clip(state.step, -wide[:, None], wide[:, None])
    return centres


def sphere_fits(
    clouds: Sequence[np.ndarray], centres: np.ndarray, radii: np.ndarray, view: np.ndarray | None, max_incidence: float, max_noise: float
) -> list[SphereFit | None]:
    """Fit from starts within about a tenth of the radius. clouds: (n, 3) float64 mm each. None if too few points remain.

    view: (3,) unit vector towards the scanner, None to take it from the caps. Points measured at more than ``max_incidence`` rad are
    omitted by their direction from the centre, which the noise along the normal cannot change.
    """
    work = _Work(clouds)
    ceiling = np.full(len(radii), max_noise)
    gate = TUKEY * ceiling
    if view is None:  # towards the scanner the caps bulge
        centres, gate, state = _iterated(work, centres, radii, gate, ceiling, None, -1.0)
        bulge = np.sum(np.einsum("kin,kn->ki", state.u, state.w) / state.noise[:, None] ** 2, axis=0)
        view = np.asarray(bulge / (np.linalg.norm(bulge) or 1.0))
    centres, _, state = _iterated(work, centres, radii, gate, ceiling, view, np.cos(max_incidence))
    fits, disk = [], _across(view) / np.sin(max_incidence)
    for j in range(len(radii)):
        used = np.flatnonzero(state.w[j])
        u, f, w = state.u[j].take(used, axis=1), state.f[j].take(used), state.w[j].take(used)
        f -= state.step[j] @ u
        fits.append(_summary(centres[j], u, f, w, state.normal[j], disk) if len(f) >= MIN_POINTS else None)
    return fits


def _iterated(
    work: _Work, centres: np.ndarray, radii: np.ndarray, gate: np.ndarray, ceiling: np.ndarray, view: np.ndarray | None, limit: float
) -> tuple[np.ndarray, np.ndarray, _State]:
    """Centres, gate (k,) mm and state after Gauss-Newton steps until none moves a centre by more than a nanometre.

    A few steps where the view is not known: on all points. limit: cosine of the largest incidence.
    """
    noise, round_ = None, 0
    while True:
        state = work.step(centres, radii, gate, ceiling, noise, view, limit)
        centres = centres + state.step
        gate = np.minimum(gate, 4 * TUKEY * state.noise)
        # estimated anew in two rounds, then kept, so that the iteration has a fixed point
        noise = None if round_ in (0, 2) else state.noise
        settled = round_ > 3 and np.max(np.sum(state.step**2, axis=1), initial=0.0) < 1e-12
        round_ += 1
        if settled or round_ == (VIEW_ROUNDS if view is None else MAX_ROUNDS):
            return centres, gate, state


class _Work:
    """Points (k, 3, n) of k spheres, which of them are real (k, n), and arrays used again in every step,
    as allocating them takes longest."""

    def __init__(self, clouds: Sequence[np.ndarray]) -> None:
        longest = max(1, max(len(p) for p in clouds))
        self.points = np.zeros((len(clouds), 3, longest))
        self.valid = np.zeros((len(clouds), longest), dtype=bool)
        for j, cloud in enumerate(clouds):
            self.points[j, :, : len(cloud)] = cloud.T
            self.valid[j, : len(cloud)] = True
        self.offset, self.weighted = np.empty_like(self.points), np.empty_like(self.points)
        self.distance, self.f, self.w, self.size = (np.empty(self.valid.shape) for _ in range(4))

    def step(self, centres, radii, gate, ceiling, noise, view, limit) -> _State:
        """One step of all spheres; noise (k,) mm is estimated if None, and at most ``ceiling`` (k,)."""
        offset, distance, f, w, size = self.offset, self.distance, self.f, self.w, self.size
        np.subtract(self.points, centres[:, :, None], out=offset)
        np.einsum("kin,kin->kn", offset, offset, out=distance)
        np.sqrt(distance, out=distance)
        np.subtract(distance, radii[:, None], out=f)
        np.abs(f, out=size)
        use = self.valid & (size < gate[:, None])
        if view is not None:
            np.multiply(distance, limit, out=w)
            use &= np.einsum("kin,i->kn", offset, view, out=self.weighted[:, 0]) > w
        distance += 1e-300
        offset /= distance[:, None]
        if noise is None:
            median = [np.partition(r, len(r) // 2)[len(r) // 2] if len(r) else 0.0 for r in (size[j][use[j]] for j in range(len(size)))]
            noise = np.clip(1.4826 * np.array(median), NOISE_FLOOR_MM, ceiling)
        np.divide(f, (TUKEY * noise)[:, None], out=w)
        w *= w
        np.subtract(1.0, w, out=w)
        np.maximum(w, 0.0, out=w)
        w *= w
        w *= use
        np.multiply(offset, w[:, None], out=self.weighted)
        normal = self.weighted @ np.swapaxes(offset, 1, 2)
        step = np.linalg.solve(normal + 1e-9 * np.eye(3), self.weighted @ f[:, :, None])[:, :, 0]
        return _State(offset, f, w, normal, step, noise)


def _summary(centre, u, f, w, normal, disk) -> SphereFit:
    """u: (3, n) directions of the points used, f (n,) mm, w (n,); disk: see ``_coverage``."""
    total = float(w.sum())
    variance = float(w @ (f * f)) / max(total - 3, 1.0) / VARIANCE_SHARE
    covariance = COVARIANCE_FACTOR * variance * np.linalg.inv(normal + 1e-12 * np.eye(3))
    # one more Gauss-Newton step with the radius free: f = u dc + dR
    free = np.empty((4, 4))
    free[:3, :3], free[3, 3] = normal, total
    free[:3, 3] = free[3, :3] = u @ w
    inverse = np.linalg.inv(free + 1e-12 * np.eye(4))
    radius_error = float(inverse[3] @ np.append(u @ (w * f), w @ f))
    noise, rms, radius_sigma = (float(np.sqrt(x)) for x in (variance, f @ f / len(f), variance * max(inverse[3, 3], 0.0)))
    return SphereFit(centre, covariance, noise, rms, len(f), _coverage(disk @ u), radius_error, radius_sigma=radius_sigma)


def _across(view: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) across a view (3,)."""
    side = np.cross(view, np.eye(3)[np.argmin(np.abs(view))])
    side /= np.linalg.norm(side) or 1.0
    return np.stack([side, np.cross(view, side)])


def _coverage(place: np.ndarray) -> float:
    """Share of the cells of the unit disk that hold a point; fewer cells where there are few points.

    place: (2, n) of the points on the disk, which is the cap within the limit of incidence seen along the view.
    """
    cells = int(np.clip(np.sqrt(place.shape[1] / 4), 4, 12))
    row, column = np.clip(((place + 1) * (cells / 2)).astype(int), 0, cells - 1)
    covered = np.bincount(row * cells + column, minlength=cells * cells) > 0
    inside = _inside(cells)
    return float(np.count_nonzero(covered & inside) / np.count_nonzero(inside))


@cache
def _inside(cells: int) -> np.ndarray:
    """(cells * cells,) bool: the cells of a square whose middle lies in the disk that fills it."""
    middle = (np.arange(cells) + 0.5) / (cells / 2) - 1
    return (middle[:, None] ** 2 + middle**2 < 1).ravel()
