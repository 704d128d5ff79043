"""All scans of one fixed part brought together at once: where the scene stands before the scanner at each pose, and how well that is known.

In every cell of the surface each scan has a height: what it is off by, the surface's own unknown height, and the scan's noise, which is
its own and so common to all overlaps that it takes part in. Generalised least squares over all cells gives the scans' rigid motions with
their joint covariance. Taken pair by pair, overlaps of one scan would count its noise anew each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse.csgraph import connected_components

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import SurfaceCells, surface_cells
from mbcacq.parts.scans import ScanSurface, spacing, thinned
from mbcacq.parts.step import SmoothNoise, motions, smooth_noise

PLAIN = SmoothNoise(0.0, 1.0)
# Share of the largest information below which a motion of several scans is not determined: of thirty scans in a row. With coarse cells,
# whose surface is not that of a quadric, weak motions would follow that misfit.
LEAST_INFORMATION, LEAST_COARSE = 1e-4, 1e-2
LEAST_SHARED = 0.1  # of a scan's own variance: less is not kept apart
OPEN_MM = 100.0  # sigma of a motion that a scan does not determine


@dataclass(frozen=True)
class RegisteredScene:
    """N scans of one scene, whose frame has the axes of the base and its origin in the middle of the surface.

    Attributes
    ----------
    T_scanner_scene : ndarray
        (N, 4, 4) mm.
    covariance : ndarray
        (N, 6, 6) of each, its scan's own: position in mm and rotation vector in rad, in the scanner frame.
    shared : ndarray
        (N, 6, K) change by one standard deviation of each of K further errors: what scans with small overlaps share, and motions that a
        scan does not determine, which are left open.
    T_base_scene : ndarray
        (4, 4) where the placement that was given has it.
    left_out : tuple[int, ...]
        Scans that do not overlap with the others.
    noise : SmoothNoise
        Of one scan.
    """

    T_scanner_scene: np.ndarray
    covariance: np.ndarray
    shared: np.ndarray
    T_base_scene: np.ndarray
    left_out: tuple[int, ...]
    noise: SmoothNoise


@dataclass(frozen=True)
class _Motions:
    """Rigid motions by which scans are off, each about its own middle: twist (N, 6) mm and rad.

    information: over the coefficients of the directions (6, r) that each scan determines, with the surface's heights eliminated;
    own: (r, r) of each scan, as if these were known. residual: (g,) mm of the groups.
    """

    twist: np.ndarray
    centre: np.ndarray
    directions: list[np.ndarray]
    open_: list[np.ndarray]
    information: np.ndarray
    own: list[np.ndarray]
    residual: np.ndarray


@dataclass(frozen=True)
class RegisteredScans:
    """N scans that were brought together.

    T_base_scanner: (N, 4, 4) mm. used: numbers of those that hang together. noise: of one scan. cells: of all scans, as they are
    placed. middle: (3,) mm of the surface.
    """

    T_base_scanner: np.ndarray
    used: np.ndarray
    noise: SmoothNoise
    cells: SurfaceCells
    motions: _Motions
    middle: np.ndarray


def brought_together(surfaces: Sequence[ScanSurface], T_base_scanner: np.ndarray, options: PartOptions) -> RegisteredScans:
    """Bring thinned scans together.

    Parameters
    ----------
    surfaces
        N scans in the scanner frame.
    T_base_scanner
        (N, 4, 4) mm, where they are to a few millimetres.
    options
        Sizes of the cells, and what counts as gross.

    Raises
    ------
    ConfigError
        No two scans overlap enough.
    """
    edge, T = cell_edge(surfaces, options), T_base_scanner
    for factor in options.coarse:
        fewer = [thinned(surface, int(len(surface.points) / factor**2)) for surface in surfaces]
        for _ in range(options.steps):
            cells, used = _connected(_cells(fewer, T, edge * factor, options), len(T), max(8, int(options.cells[0] / factor)), options)
            T, moved = _moved(T, used, _motions(cells, len(used), PLAIN, options))
            if moved < options.captured * edge * factor / 4:
                break
    every = _cells(surfaces, T, edge, options)
    cells, used = _connected(every, len(T), options.cells[0], options)
    noise = _noise(cells, len(used), options)
    found = _without_gross(cells, len(used), noise, options)
    for _ in range(options.steps):
        T, moved = _moved(T, used, found)
        every = _cells(surfaces, T, edge, options)
        if moved < noise.sigma_mm:
            break
        cells, used = _connected(every, len(T), options.cells[0], options)
        found = _without_gross(cells, len(used), noise, options)
    return RegisteredScans(T, used, noise, every, found, cells.point.mean(axis=0))


def cell_edge(surfaces: Sequence[ScanSurface], options: PartOptions) -> float:
    """Edge in mm of the cells in which scans are compared."""
    return options.spacings_per_cell * float(np.median([spacing(s.points) for s in surfaces]))


def register(surfaces: Sequence[ScanSurface], T_base_scanner: np.ndarray, options: PartOptions) -> RegisteredScene:
    """Bring scans together as ``brought_together`` does, and say how well that is known."""
    return _scene(brought_together(surfaces, T_base_scanner, options))


def _cells(surfaces: Sequence[ScanSurface], T: np.ndarray, edge: float, options: PartOptions) -> SurfaceCells:
    placed = [(se3.apply(M, s.points), s.normals @ M[:3, :3].T) for M, s in zip(T, surfaces, strict=True)]
    return surface_cells(placed, edge, options)


def _connected(cells: SurfaceCells, count: int, least: int, options: PartOptions) -> tuple[SurfaceCells, np.ndarray]:
    """The cells of the largest set of scans that hang together by ``least`` cells each, at most ``options.scene_cells``, and the numbers of
    these scans."""
    _, label = connected_components(cells.shared(count) >= least)
    used = np.flatnonzero(label == np.bincount(label).argmax())
    if len(used) < 2:
        raise ConfigError("no two scans of this part overlap enough to be compared; scan it with views that share a third of what they see")
    every = -(-len(cells.point) // options.scene_cells)
    cells = cells.groups(np.isin(cells.scan, used) & (cells.cell % every == 0))
    return replace(cells, scan=np.searchsorted(used, cells.scan)), used


def _noise(cells: SurfaceCells, count: int, options: PartOptions) -> SmoothNoise:
    """The smooth noise of one scan, from the largest overlap of each: the distance of two scans has that of both. The largest overlaps of
    all are those of few scans, whose noise would be taken for that of all."""
    with_most = np.argmax(cells.shared(count) * (1 - np.eye(count)), axis=1)
    pairs = {(min(pair), max(pair)) for pair in enumerate(with_most.tolist())}
    found = smooth_noise([cells.pair(i, j) for i, j in sorted(pairs)], options)
    return replace(found, sigma_mm=found.sigma_mm / np.sqrt(2))


def _moved(T: np.ndarray, used: np.ndarray, found: _Motions) -> tuple[np.ndarray, float]:
    """The placements (N, 4, 4) with the motions taken back, and the largest shift in mm."""
    shift, turn = -found.twist[:, :3], -found.twist[:, 3:]
    about = np.concatenate([shift - np.cross(turn, found.centre), turn], axis=1)
    out = T.copy()
    out[used] = se3.exp(about) @ T[used]
    return out, float(np.abs(shift).max())


def _without_gross(cells: SurfaceCells, count: int, noise: SmoothNoise, options: PartOptions) -> _Motions:
    found = _motions(cells, count, noise, options)
    for _ in range(options.rounds):
        size = np.abs(found.residual)
        good = size < options.gross * max(1.4826 * float(np.median(size)), float(np.sqrt(np.median(cells.variance))))
        if good.all():
            break
        cells = cells.groups(good)
        found = _motions(cells, count, noise, options)
    return found


def _motions(cells: SurfaceCells, count: int, noise: SmoothNoise, options: PartOptions) -> _Motions:
    centre, directions, open_, own, columns, of_scan = [], [], [], [], [], []
    m = len(cells.point)
    heights, beside, side = np.zeros((m, m)), [], np.zeros(m)  # normal equations of the heights
    for i in range(count):
        here = np.flatnonzero(cells.scan == i)
        at = cells.cell[here]
        weight = np.linalg.inv(noise.covariance_of(cells.point[at], cells.variance[here]))
        middle, scale, J, shown, not_shown = motions(cells.point[at], cells.normal[at], options)
        A = J @ shown
        heights[np.ix_(at, at)] += weight
        side[at] += weight @ cells.height[here]
        mixed = np.zeros((A.shape[1], m))
        mixed[:, at] = A.T @ weight
        beside.append(mixed)
        own.append(mixed[:, at] @ A)
        of_scan.append(mixed[:, at] @ cells.height[here])
        columns.append((here, at, A))
        centre.append(middle)
        directions.append(shown / scale[:, None])
        open_.append(not_shown / scale[:, None])
    first = np.cumsum([0, *(d.shape[1] for d in directions)])
    inside = [slice(a, b) for a, b in zip(first[:-1], first[1:], strict=True)]
    mixed = np.concatenate(beside)
    solved = np.linalg.solve(heights, np.column_stack([mixed.T, side]))
    information = -mixed @ solved[:, :-1]
    for place, block in zip(inside, own, strict=True):
        information[place, place] += block
    value, vector, _ = _modes(information, LEAST_COARSE if noise is PLAIN else LEAST_INFORMATION)
    u = vector @ ((vector.T @ (np.concatenate(of_scan) - mixed @ solved[:, -1])) / value)
    surface = solved[:, -1] - solved[:, :-1] @ u
    residual = np.zeros(len(cells.height))
    for place, (here, at, A) in zip(inside, columns, strict=True):
        residual[here] = cells.height[here] - A @ u[place] - surface[at]
    twist = np.stack([D @ u[place] for D, place in zip(directions, inside, strict=True)])
    return _Motions(twist, np.array(centre), directions, open_, information, own, residual)


def _scene(of: RegisteredScans) -> RegisteredScene:
    T, used, found, origin = of.T_base_scanner, of.used, of.motions, of.middle
    own = _diagonal([np.linalg.inv(block) for block in found.own])
    root = np.linalg.cholesky(own)
    known, V, rest = _modes(found.information, LEAST_INFORMATION)
    # Beyond what each scan has of its own, in units of that: what the unknown heights add. Motions of all scans alike do not count.
    back = np.linalg.inv(root)
    size, mode = np.linalg.eigh(back @ (V @ (np.diag(1 / known) - V.T @ own @ V) @ V.T) @ back.T)
    kept = size > LEAST_SHARED
    # Motions of all scans alike are the scene's place; others that are not determined are open.
    arms = found.centre - origin
    alike = np.concatenate([np.linalg.pinv(D) @ _about(-arm) for D, arm in zip(found.directions, arms, strict=True)])
    alike = np.linalg.svd(alike / np.maximum(np.linalg.norm(alike, axis=0), 1e-9), full_matrices=False)
    alike = alike[0][:, alike[1] > 1e-6]
    rest, share, _ = np.linalg.svd(rest - alike @ (alike.T @ rest), full_matrices=False)
    seen = [np.kron(np.eye(2), M[:3, :3].T) @ _about(arm) for M, arm in zip(T[used], arms, strict=True)]
    determined, open_ = (_diagonal([S @ D for S, D in zip(seen, each, strict=True)]) for each in (found.directions, found.open_))
    modes = np.concatenate([root @ (mode[:, kept] * np.sqrt(size[kept])), OPEN_MM * rest[:, share > 0.1]], axis=1)
    shared = np.concatenate([determined @ modes, OPEN_MM * open_], axis=1)
    # A scan's own covariance is as usual along what is open.
    total = determined @ own @ determined.T + float(np.mean(np.diag(own))) * open_ @ open_.T
    blocks = total.reshape(len(used), 6, len(used), 6)[np.arange(len(used)), :, np.arange(len(used))]
    T_base_scene = se3.transform(np.eye(3), origin)
    left_out, placed = tuple(sorted({*range(len(T))} - {*used.tolist()})), se3.inverse(T[used]) @ T_base_scene
    return RegisteredScene(placed, blocks, shared.reshape(len(used), 6, -1), T_base_scene, left_out, of.noise)


def _modes(information: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues (k,) and eigenvectors of an information that are known, and eigenvectors that are not."""
    value, vector = np.linalg.eigh((information + information.T) / 2)
    known = value > least * value[-1]
    return value[known], vector[:, known], vector[:, ~known]


def _about(arm: np.ndarray) -> np.ndarray:
    """(6, 6): a twist about a point as one about another; arm (3,) mm, from that one to the first."""
    out = np.eye(6)
    out[:3, 3:] = se3.skew(arm)
    return out


def _diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(block_diag(*blocks), dtype=float)  # pyright: ignore[reportCallIssue, reportArgumentType] -- wrong stubs
