"""Views of a part that show its surface: coverage by ray casting, then few views that cover it and hang together.

Choosing views is a set cover: greedy growth (Chvatal 1979), then exchange of two views for one and of views for none.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mbcacq.design.candidate_views import AT_ONCE, SeenView, ViewChoice, random_views
from mbcacq.design.options import DesignOptions
from mbcacq.design.plan_rewriter import view_mapping, with_steps
from mbcacq.errors import ConfigError
from mbcacq.files.mesh_file import Mesh
from mbcacq.files.open3d_library import open3d
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan
from mbcacq.plan.field_of_view import T_base_scanner, aim_depth, margin
from mbcacq.plan.occlusion import camera_height
from mbcacq.plan.schema import PartView, ScanPart
from mbcacq.quantities import from_degrees, in_degrees

ABOVE_MM = 0.05  # of a ray's start above the surface that it leaves


@dataclass(frozen=True)
class PartCoverage:
    """Views of a part.

    Attributes
    ----------
    text : str
        The plan with them.
    views : int
        Their number.
    covered : float
        Share of the surface that they show, of what any view that can be taken shows.
    visible : float
        Share of the whole surface that any of these shows.
    tried : int
        Number of views that can be taken.
    """

    text: str
    views: int
    covered: float
    visible: float
    tried: int


@dataclass(frozen=True)
class PartViews:
    """Views of a part that the arm can take. views: with joint positions q (K, n) rad; shown: (K, S) bool, which of S points of the surface
    each shows."""

    views: tuple[SeenView, ...]
    q: np.ndarray
    shown: np.ndarray


def design_part(
    loaded: LoadedPlan, mesh: Mesh | None, steepest_deg: float, seed: int, options: DesignOptions | None = None
) -> PartCoverage:
    """The plan with the fewest views found for its first step that scans a part.

    Parameters
    ----------
    loaded
        The plan.
    mesh
        Surface of the part in its frame, mm; None: that of its artefact.
    steepest_deg
        Steepest view against the z axis of the station, deg.
    seed
        Of the views and points to choose from.
    options
        Numbers that tune the choice.

    Raises
    ------
    ConfigError
        The plan scans no part, the part has no mesh, or no view of it can be taken.
    """
    options = options or DesignOptions()
    step = next((s for s in loaded.plan.steps if isinstance(s, ScanPart)), None)
    if step is None:
        raise ConfigError(f"{loaded.path} scans no part; add a step with `do: scan`, whose views are then chosen")
    found = part_views(loaded, str(step.stations[0]), mesh, steepest_deg, seed, options)
    chosen = in_short_order(loaded, found, fewest_views(found.shown, options))
    views = [view_mapping(found.views[k].view) for k in chosen]
    new: dict[str, Any] = {"name": step.name, "phase": step.phase, "do": "scan", "stations": list(step.stations)}
    text = with_steps(loaded, [{**new, **({"exposures": step.exposures} if step.exposures else {}), "views": views}], "part")
    any_view = found.shown.any(axis=0)
    covered = found.shown[chosen].any(axis=0).sum() / any_view.sum()
    return PartCoverage(text, len(chosen), float(covered), float(any_view.mean()), len(found.views))


def part_views(loaded: LoadedPlan, station: str, mesh: Mesh | None, steepest_deg: float, seed: int, options: DesignOptions) -> PartViews:
    """Random views of a part, half of them along the normals of its surface. Raises ConfigError where none can be taken."""
    artefact = loaded.cell.artefact(loaded.cell.station(station).artefact)
    mesh = mesh or artefact.mesh
    if mesh is None:
        raise ConfigError(f"part '{artefact.id}' is known by its box alone; give the mesh of its surface: --part part.stl")
    rng = np.random.default_rng(seed)
    points, normals = _samples(mesh, options.surface_points, rng)
    steepest_deg = min(steepest_deg, in_degrees(loaded.planning.steepest_view))
    views = _aimed(points, normals, random_views(options.part_views, steepest_deg, rng, options), steepest_deg, rng)
    depth, place = aim_depth(loaded.plan.scanner.field_of_view), loaded.cell.station(station).planned_pose
    T = np.stack([T_base_scanner(place, np.array(v.at_mm), v, depth) for v in views])
    flanges = T @ se3.inverse(loaded.cell.T_flange_scanner)
    seen = [SeenView(station, None, view, flange, ()) for view, flange in zip(views, flanges, strict=True)]
    choice = ViewChoice(loaded, options)
    postures = [q for k in range(0, len(seen), AT_ONCE) for q in choice.postures(seen[k : k + AT_ONCE])]
    kept = [k for k, q in enumerate(postures) if q is not None]
    if not kept:
        raise ConfigError(f"the arm can take no view of part '{artefact.id}' at station '{station}'; move the station, or tilt more")
    shown = _shown(loaded, mesh, points, normals, se3.inverse(T[kept]) @ place, options)
    return PartViews(tuple(seen[k] for k in kept), np.array([postures[k] for k in kept]), shown)


def _samples(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (S, 3) spread evenly over a surface, and its normals there."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    which = np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(count) + rng.random(count)) / count)
    which = np.minimum(which, len(area) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[which] + u * (b - a)[which] + v * (c - a)[which], normal[which] / area[which, None]


def _aimed(points: np.ndarray, normals: np.ndarray, views: list[Any], steepest_deg: float, rng: np.random.Generator) -> list[PartView]:
    """The views, each aimed at a point of the surface; every second one looks along its normal, as far as that may be."""
    out = []
    for k, (view, at) in enumerate(zip(views, rng.integers(len(points), size=len(views)), strict=True)):
        tilt, azimuth = view.tilt_deg, view.azimuth_deg
        if k % 2:
            x, y, z = normals[at]
            tilt, azimuth = min(in_degrees(np.arccos(np.clip(z, -1, 1))), steepest_deg), in_degrees(np.arctan2(y, x))
        aim = np.rint(points[at]).tolist()
        turned = {"tilt_deg": float(np.rint(tilt)), "azimuth_deg": float(np.rint(azimuth)), "roll_deg": view.roll_deg}
        out.append(PartView(at_mm=(aim[0], aim[1], aim[2]), wrist=view.wrist, **turned))
    return out


def _shown(
    loaded: LoadedPlan, mesh: Mesh, points: np.ndarray, normals: np.ndarray, T_scanner_part: np.ndarray, options: DesignOptions
) -> np.ndarray:
    """(K, S) bool: whether a point lies in the field of view, is not seen too flat, and nothing of the part hides it."""
    field, o3d = loaded.plan.scanner.field_of_view, open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles.astype(np.uint32)))
    least, camera = np.cos(from_degrees(options.flattest_deg)), np.array([0.0, 0.0, camera_height(field)])
    out = np.zeros((len(T_scanner_part), len(points)), dtype=bool)
    for k, T in enumerate(T_scanner_part):
        way = se3.apply(se3.inverse(T), camera[None]) - points
        way /= np.linalg.norm(way, axis=1)[:, None]
        out[k] = (margin(field, se3.apply(T, points)) >= 0) & (np.einsum("sc,sc->s", way, normals) > least)
        at = np.flatnonzero(out[k])
        rays = np.concatenate([points[at] + ABOVE_MM * normals[at], way[at]], axis=1).astype(np.float32)
        out[k, at] = ~scene.test_occlusions(o3d.core.Tensor(rays), nthreads=1).numpy()
    return out


def fewest_views(shown: np.ndarray, options: DesignOptions) -> list[int]:
    """Indices of few views that show ``options.coverage`` of what all show (K, S) bool, and hang together by overlaps."""
    needed = options.coverage * shown.any(axis=0).sum()
    count, weight = shown.sum(axis=1), shown.astype(np.float32)
    shared = weight @ weight.T
    near = shared >= options.overlap * np.minimum(count, count[:, None])

    def good(views: list[int]) -> bool:
        together = connected_components(csr_array(near[np.ix_(views, views)]))[0] == 1
        return together and shown[views].any(axis=0).sum() >= needed

    chosen = [int(np.argmax(count))]
    while shown[chosen].any(axis=0).sum() < needed:
        gain = (shown & ~shown[chosen].any(axis=0)).sum(axis=1)
        joined = np.where(near[chosen].any(axis=0), gain, 0)
        chosen.append(int(np.argmax(joined if joined.any() else gain)))
    while True:
        without = ([c for c in chosen if c != k] for k in chosen)
        fewer = next((rest for rest in without if good(rest)), None) or _two_for_one(shown, weight, chosen, good)
        if fewer is None:
            return chosen
        chosen = fewer


def _two_for_one(shown: np.ndarray, weight: np.ndarray, chosen: list[int], good: Any) -> list[int] | None:
    """The views with two of them replaced by another one, None where no such exchange is good."""
    times, every = shown[chosen].sum(axis=0), shown.any(axis=0)
    for a, b in combinations(chosen, 2):
        rest = [c for c in chosen if c not in (a, b)]
        lost = every & (times - shown[a] - shown[b] <= 0)
        for k in np.argsort(-(weight @ lost.astype(np.float32)))[:3].tolist():
            if good([*rest, k]):
                return [*rest, k]
    return None


def in_short_order(loaded: LoadedPlan, found: PartViews, chosen: list[int]) -> list[int]:
    """The views in an order of short motions from home: the nearest next, then reversed stretches while that shortens the way."""
    q = np.concatenate([[loaded.plan.robot.home], found.q[chosen]])
    far = np.abs(q[:, None] - q).max(axis=2)  # the axis that turns most takes longest
    way = [0]
    while len(way) < len(q):
        way.append(min((k for k in range(len(q)) if k not in way), key=lambda k: far[way[-1], k]))
    better = True
    while better:
        better = False
        for a, b in combinations(range(1, len(way)), 2):
            turned = [*way[:a], *way[a : b + 1][::-1], *way[b + 1 :]]
            if _length(far, turned) < _length(far, way) - 1e-9:
                way, better = turned, True
    return [chosen[k - 1] for k in way[1:]]


def _length(far: np.ndarray, way: list[int]) -> float:
    """The length of a way that ends where it began."""
    return float(far[way, [*way[1:], way[0]]].sum())
