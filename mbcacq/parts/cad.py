"""A merged cloud against the CAD model of the part: best fit, and the deviation of each point along the model's normal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.mesh_file import Mesh
from mbcacq.files.open3d_library import open3d
from mbcacq.geometry import se3
from mbcacq.parts.merge import merged_points, xyz_of
from mbcacq.parts.options import PartOptions
from mbcacq.quantities import K
from mbcacq.spheres.cloud_file import UNITS_MM

CHUNK = 500_000
MOST_DRAWN = 60_000
MAP_CELLS = 60  # along each side


@dataclass(frozen=True)
class CadDeviations:
    """Signed deviations from the model, outwards positive, over the points that lie within reach of it.

    Attributes
    ----------
    T_base_cad : ndarray
        (4, 4) mm, where the model lies.
    fitted : bool
        Whether that is the best fit; else the planned place of the part.
    points : int
        Number of points that count.
    apart : int
        Number of points farther from the model than the reach: of the fixture, or of another part.
    mean_mm, rms_mm, largest_mm : float
        Over the points.
    within_95_mm : float
        95 % of the deviations are smaller.
    expected_mm : float
        rms of the points' standard uncertainties along the normal: what a perfect part would show.
    U_mm : float
        Median expanded uncertainty (k = 2) of a point.
    beyond_U : float
        Share of the points that deviate by more than their U.
    drawn : ndarray
        (d, 4) some of the points in the CAD frame, mm, with their deviations.
    """

    T_base_cad: np.ndarray
    fitted: bool
    points: int
    apart: int
    mean_mm: float
    rms_mm: float
    largest_mm: float
    within_95_mm: float
    expected_mm: float
    U_mm: float
    beyond_U: float
    drawn: np.ndarray

    @property
    def sentence(self) -> str:
        text = (
            f"the part deviates from its CAD model by {self.rms_mm:.3f} mm (rms; mean {self.mean_mm:+.4f}, 95 % within "
            f"{self.within_95_mm:.3f}, largest {self.largest_mm:.3f}); a perfect part would show {self.expected_mm:.3f}"
        )
        return f"{text}; {100 * self.beyond_U:.1f} % of the points deviate by more than their U (k = 2, {self.U_mm:.3f} mm in the median)"

    def to_dict(self) -> dict[str, Any]:
        plain = {name: value for name, value in vars(self).items() if name not in ("drawn", "T_base_cad")}
        return {**plain, "sentence": self.sentence, "T_base_cad": self.T_base_cad.tolist(), "map": self._map()}

    def _map(self) -> dict[str, Any]:
        """Mean deviation over x and y of the CAD frame, None if there is no point."""
        x, y, _, along = self.drawn.T
        edges = [np.linspace(v.min(), v.max(), MAP_CELLS + 1) for v in (x, y)]
        count = np.histogram2d(y, x, bins=edges[::-1])[0]
        total = np.histogram2d(y, x, bins=edges[::-1], weights=along)[0]
        mean = [[None if n == 0 else round(t / n, 6) for t, n in zip(*row, strict=True)] for row in zip(total, count, strict=True)]
        middles = [((e[1:] + e[:-1]) / 2).tolist() for e in edges]
        return {"x_mm": middles[0], "y_mm": middles[1], "deviation_mm": mean}


def compare_with_cad(cloud: Path, mesh: Mesh, T_base_cad: np.ndarray, options: PartOptions, *, fit: bool = True) -> CadDeviations:
    """Compare a merged cloud with a mesh in mm.

    T_base_cad: (4, 4) where the model lies roughly, or where it does lie if ``fit`` is False; then uncertainties are those in the base
    frame. Raises ConfigError if the model is not that of this part, or no point of the cloud lies near it.
    """
    surface, points = _Surface(mesh), merged_points(cloud)
    some = points[:: max(1, len(points) // options.points_per_scan)]
    best = surface.fitted(some, T_base_cad, options)
    surface.refuse_other_part(xyz_of(some), best, options)
    T = best if fit else T_base_cad
    deviation, sigma, drawn, apart = [], [], [], 0
    every = max(1, len(points) // MOST_DRAWN)
    for start in range(0, len(points), CHUNK):
        some = points[start : start + CHUNK]
        placed = se3.apply(se3.inverse(T), xyz_of(some))
        along = surface.distances(placed)[0]
        near = np.abs(along) < options.cad_reach_mm
        apart += int((~near).sum())
        deviation.append(along[near])
        sigma.append(some["sigma_mm" if fit else "sigma_base_mm"][near].astype(float))
        drawn.append(np.column_stack([placed[near], along[near]])[::every].copy())
    d, s = np.concatenate(deviation), np.concatenate(sigma)
    if not len(d):
        raise ConfigError(f"no point of {cloud} lies within {options.cad_reach_mm:g} mm of the model; is its frame that of the plan?")
    return CadDeviations(
        T_base_cad=T,
        fitted=fit,
        points=len(d),
        apart=apart,
        mean_mm=float(d.mean()),
        rms_mm=float(np.sqrt(np.mean(d**2))),
        largest_mm=float(np.abs(d).max()),
        within_95_mm=float(np.quantile(np.abs(d), 0.95)),
        expected_mm=float(np.sqrt(np.mean(s**2))),
        U_mm=K * float(np.median(s)),
        beyond_U=float(np.mean(np.abs(d) > K * s)),
        drawn=np.concatenate(drawn),
    )


class _Surface:
    """A mesh that answers which of its points is nearest. Coordinates are taken from its middle: the rays are in single precision."""

    def __init__(self, mesh: Mesh) -> None:
        self._corner = mesh.vertices[mesh.triangles]
        self._middle = mesh.vertices.mean(axis=0)
        normal = np.cross(self._corner[:, 1] - self._corner[:, 0], self._corner[:, 2] - self._corner[:, 0])
        self._normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        core = open3d().core
        self._scene = open3d().t.geometry.RaycastingScene(nthreads=1)
        vertices = (mesh.vertices - self._middle).astype(np.float32)
        self._scene.add_triangles(core.Tensor(vertices), core.Tensor(mesh.triangles.astype(np.uint32)))

    def distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distance (N,) mm of points (N, 3) in the mesh's frame, the nearest points (N, 3), and the normals there (N, 3)."""
        query = open3d().core.Tensor((points - self._middle).astype(np.float32))
        found = self._scene.compute_closest_points(query, nthreads=1)
        nearest = found["points"].numpy().astype(float) + self._middle
        normal = self._normal[found["primitive_ids"].numpy().astype(np.int64)]
        away = points - nearest
        along, length = np.einsum("nc,nc->n", away, normal), np.linalg.norm(away, axis=1)
        return np.where(length > 2 * np.abs(along), np.copysign(length, along), along), nearest, normal  # beside an edge: the length

    def refuse_other_part(self, base: np.ndarray, T: np.ndarray, options: PartOptions) -> None:
        """Raise ConfigError if points (N, 3) of the base frame have another shape than the mesh, which fits them best at T (4, 4)."""
        placed, corners = se3.apply(se3.inverse(T), base), self._corner.reshape(-1, 3)
        low, high = corners.min(axis=0) - options.fit_capture_mm, corners.max(axis=0) + options.fit_capture_mm
        placed = placed[((placed > low) & (placed < high)).all(axis=1)]  # the rest is of the fixture
        if len(placed):
            arm = placed - placed.mean(axis=0)
            relief = np.median(np.abs(arm @ np.linalg.eigh(arm.T @ arm)[1][:, 0]))
            size = float(np.linalg.norm(np.ptp(placed, axis=0)))
            off = np.median(np.abs(self.distances(placed)[0]))
            if off < max(options.other_relief * relief, options.other_size * size):
                return
        long, seen = float(np.ptp(corners, axis=0).max()), float(np.ptp(base, axis=0).max())
        units = [unit for unit, mm in UNITS_MM.items() if mm != 1 and 0.5 < seen / long / mm < 2]
        raise ConfigError(
            f"the CAD model, {long:.3g} mm long, has another shape than the merged cloud, {seen:.3g} mm long; give the mesh of this part, "
            f"not mirrored, {'in mm instead of ' + units[0] if units else 'in mm'}, and its rough place in the plan"
        )

    def fitted(self, points: np.ndarray, T: np.ndarray, options: PartOptions) -> np.ndarray:
        """T_base_cad of the best fit, point to plane, from a rough one; points far off by a robust measure do not count."""
        base, weight = xyz_of(points), 1 / points["sigma_mm"].astype(float)
        for _ in range(options.fit_rounds):
            placed = se3.apply(se3.inverse(T), base)
            along, nearest, normal = self.distances(placed)
            reach = np.clip(4 * 1.4826 * np.median(np.abs(along)), 1e-3, options.fit_capture_mm)
            near = np.abs(along) < reach
            arm = nearest[near] - self._middle
            J = np.column_stack([normal[near], np.cross(arm, normal[near])]) * weight[near, None]
            step = np.linalg.lstsq(J, along[near] * weight[near], rcond=1e-6)[0]
            turn = step[3:]
            T = T @ se3.exp(np.concatenate([step[:3] - np.cross(turn, self._middle), turn]))
            if np.abs(step[:3]).max() < 1e-5 and np.abs(turn).max() < 1e-8:
                break
        return T
