"""Cloud to named ball centres: patches, votes, fits, recognition."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.errors import ConfigError, DeviceFault
from mbcacq.model.cell import Artefact
from mbcacq.spheres.candidates import sphere_candidates
from mbcacq.spheres.fit import SphereFit, rough_fits, sphere_fits
from mbcacq.spheres.found import FoundSpheres, Refusals, SphereOptions
from mbcacq.spheres.naming import identify_spheres
from mbcacq.spheres.recognise import size_classes
from mbcacq.spheres.voxels import Patches, Voxels, patches, voxelise

MAX_CANDIDATES = 60


def find_spheres(
    points: np.ndarray,
    artefact: Artefact,
    *,
    expected: Sequence[int] | None = None,
    predicted: np.ndarray | None = None,
    options: SphereOptions | None = None,
) -> FoundSpheres:
    """Centres of the artefact's balls in one cloud.

    points: (N, 3) float32 or float64, mm, in any order, plates and other things included; rows that are not finite are dropped.
    expected: certificate ids that should be in view. predicted: (k, 3) mm, rough centres of ``expected`` (or of all balls of the
    artefact, in its order); needed where fewer than three balls are in view, which do not identify themselves.

    Raises DeviceFault for a wrong artefact, its mirror image, balls of another diameter, or an undecided identification;
    ConfigError for a certificate without diameters or an expected ball that it does not list. A ball that is covered, too little
    covered or too rough is absent from the result and named in ``refused`` where part of it was measured.
    """
    options = options or SphereOptions()
    _check(artefact, expected, predicted)
    columns = _finite(points)
    fits: list[tuple[float, SphereFit]] = []
    refused: Refusals = []
    surface = None
    if columns.shape[1] >= options.min_points:
        surface = Surface(columns, artefact.diameters.min() / 2)
        fits, refused = _fit_all(surface, artefact, options)
        if not fits:
            _other_diameter(surface, artefact, options)
    found = identify_spheres(fits, refused, artefact, expected, predicted, options)
    return found if surface is None else _with_own_diameters(found, surface, artefact, options)


class Surface:
    """A cloud with its cubes and patches, computed once for all radii."""

    def __init__(self, columns: np.ndarray, radius: float) -> None:
        self.columns = columns
        self.voxels: Voxels = voxelise(columns, radius / 3)
        if np.median(self.voxels.count) < 10:
            self.voxels = voxelise(columns, radius / 1.8)
        self.patches: Patches = patches(columns, self.voxels)

    def near_shells(self, centres: np.ndarray, radii: np.ndarray, margin: np.ndarray) -> list[np.ndarray]:
        """For each sphere, the points (n, 3) float64 of all cubes that come within its margin of the shell."""
        bits = np.zeros(len(self.voxels.count), dtype=np.uint64)
        middle = self.voxels.corner + self.voxels.size / 2
        for j, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            distance = np.linalg.norm(middle - centre, axis=1)
            bits[np.abs(distance - radius) < margin[j] + 0.87 * self.voxels.size] |= np.uint64(1 << j)
        rows = np.flatnonzero((bits != 0)[self.voxels.cell])
        mine, points = bits[self.voxels.cell[rows]], self.columns[:, rows].T.astype(np.float64)
        return [points[(mine & np.uint64(1 << j)) != 0] for j in range(len(centres))]


def _fit_all(surface: Surface, artefact: Artefact, options: SphereOptions):
    """Sphere fits (radius, fit) of every ball of a certified diameter, and what was refused."""
    view = None if options.view is None else np.asarray(options.view, dtype=float) / np.linalg.norm(options.view)
    starts, radii = [], []
    limit = min(3 * len(artefact.ball_ids) + 6, MAX_CANDIDATES)
    for radius in np.unique(size_classes(artefact.diameters / 2, options.radius_tolerance)):
        found, _ = sphere_candidates(surface.patches, radius, view, limit)
        starts.extend(found)
        radii.extend([radius] * len(found))
    starts, radii = np.array(starts).reshape(-1, 3)[:MAX_CANDIDATES], np.array(radii)[:MAX_CANDIDATES]
    if not len(starts):
        return [], []
    clouds = surface.near_shells(starts, radii, 0.12 * radii)
    centres = rough_fits(clouds, starts, radii, options.max_noise)
    close = np.linalg.norm(centres - starts, axis=1) < 0.5 * radii
    if not close.any():
        return [], []
    clouds = [cloud for cloud, keep in zip(clouds, close, strict=True) if keep]
    fits: list[tuple[float, SphereFit]] = []
    refused: Refusals = []
    found = sphere_fits(clouds, centres[close], radii[close], view, options.max_incidence, options.max_noise)
    for radius, fit in zip(radii[close], found, strict=True):
        if fit is None or any(np.linalg.norm(fit.centre - other.centre) < 0.5 * radius for _, other in fits):
            continue
        fault, telling = _judge(fit, radius, options)
        if fault is None:
            fits.append((radius, fit))
        elif telling:
            refused.append((fault, fit.centre))
    return fits, refused


def _with_own_diameters(found: FoundSpheres, surface: Surface, artefact: Artefact, options: SphereOptions) -> FoundSpheres:
    """The named balls fitted again, each with its own certified diameter, where those of one size differ by a little."""
    own = np.array([artefact.diameters[artefact.ball_ids.index(b)] for b in found.ball.tolist()]) / 2
    sought = dict(zip(artefact.ball_ids, size_classes(artefact.diameters / 2, options.radius_tolerance), strict=True))
    if np.allclose([sought[b] for b in found.ball.tolist()], own, rtol=1e-9, atol=0):
        return found
    view = None if options.view is None else np.asarray(options.view, dtype=float) / np.linalg.norm(options.view)
    fits = sphere_fits(surface.near_shells(found.xyz, own, 0.12 * own), found.xyz, own, view, options.max_incidence, options.max_noise)
    kept = [k for k, fit in enumerate(fits) if fit is not None]
    return FoundSpheres.of(found.ball[kept].tolist(), [fit for fit in fits if fit is not None], found.refused)


def _judge(fit: SphereFit, radius: float, options: SphereOptions) -> tuple[str | None, bool]:
    """Why a fit is not a ball, and whether it looks enough like one to be reported."""
    if fit.n_points < options.min_points:
        return f"{fit.n_points} points on a ball of {2 * radius:g} mm are too few", False
    if fit.coverage < options.min_coverage:
        reported = fit.coverage > 0.6 * options.min_coverage
        return f"only {fit.coverage:.0%} of the visible cap of a ball of {2 * radius:g} mm is covered", reported
    if fit.noise_mm > options.max_noise:
        return f"its surface is {fit.noise_mm:.3f} mm rough", True
    if abs(fit.radius_error) > options.radius_tolerance * radius + 5 * fit.radius_sigma:
        return f"its diameter is {2 * (radius + fit.radius_error):.3f} mm, not {2 * radius:g} mm", fit.coverage > 0.5
    return None, True


def _other_diameter(surface: Surface, artefact: Artefact, options: SphereOptions) -> None:
    """Raise if balls of a diameter that the certificate does not know are in view."""
    best = None
    size = surface.voxels.size
    for radius in size * np.geomspace(1.0, 15.0, 28):
        starts, votes = sphere_candidates(surface.patches, radius, None, 3)
        for start, count in zip(starts, votes, strict=True):
            cloud = surface.near_shells(start[None], np.array([radius]), np.array([0.12 * radius]))
            centre = rough_fits(cloud, start[None], np.array([radius]), 0.1 * radius)
            fit = None
            for _ in range(4):
                fit = sphere_fits(cloud, centre, np.array([radius]), None, options.max_incidence, 0.02 * radius)[0]
                if fit is None:
                    break
                centre, radius = fit.centre[None], float(np.clip(radius + fit.radius_error, 0.5 * radius, 2 * radius))
            if (
                fit is not None
                and fit.coverage > 0.5
                and fit.noise_mm < options.max_noise
                and fit.n_points >= options.min_points
                and (best is None or count > best[0])
            ):
                best = (count, radius)
    if best is not None:
        wanted = ", ".join(f"{d:g}" for d in np.unique(artefact.diameters))
        raise DeviceFault(
            f"wrong artefact in view: a ball of {2 * best[1]:.2f} mm diameter is seen, artefact '{artefact.id}' has balls of "
            f"{wanted} mm; put the right artefact in place or correct the plan"
        )


def _check(artefact: Artefact, expected: Sequence[int] | None, predicted: np.ndarray | None) -> None:
    if not (artefact.diameters > 0).all():
        raise ConfigError(
            f"artefact '{artefact.id}' has a ball without diameter_mm, which finding it in a cloud needs; add it to the certificate"
        )
    ids = artefact.ball_ids if expected is None else tuple(expected)
    for ball in ids:
        if ball not in artefact.ball_ids:
            raise ConfigError(
                f"ball {ball} is expected in view, but artefact '{artefact.id}' has the balls {list(artefact.ball_ids)}; correct the plan"
            )
    if predicted is not None and np.shape(predicted) != (len(ids), 3):
        raise ConfigError(f"predicted centres have shape {np.shape(predicted)}, for {len(ids)} balls ({len(ids)}, 3) is needed")


def _finite(points: np.ndarray) -> np.ndarray:
    """Finite points as columns (3, N), which are quicker to work on."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ConfigError(f"a cloud must have shape (N, 3), this one has {points.shape}")
    kind = points.dtype if points.dtype in (np.float32, np.float64) else np.float64
    columns = np.ascontiguousarray(points.T, dtype=kind)
    if columns.size and not (np.isfinite(columns.min()) and np.isfinite(columns.max())):
        columns = columns[:, np.isfinite(columns).all(axis=0)]
    return columns
