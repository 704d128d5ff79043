"""Numbers that tune how scans are compared and merged, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PartOptions:
    """points_per_scan: thinned to, for the steps; more hardly lower their uncertainty, which the smooth noise of a scan limits.
    points_in_memory: of all scans together, thinned.
    spacings_per_cell: edge of a cell in spacings of the thinned points, so that some 40 points lie in one.
    points_in_cell: of each scan, which a cell needs at least for its seven coefficients.
    rough: a cell with so many times the usual scatter holds an edge or a reflection.
    gross: cells with so many robust sigmas from the step are left out, in at most ``rounds`` rounds.
    cells: an overlap has at least and at most so many.
    neighbours: overlaps of a scan that are used, the largest first.
    slope: rms by which the surface must rise across a direction (rad) for the overlap to determine it. Below it the noise of the normals
    (about 0.01 rad) feigns a determination.
    captured: share of a cell by which scans may be apart for their step to be that of one linearisation.
    steps: linearisations, at most.
    coarse: sizes of the cells, in those at last, by which scans that are millimetres apart are brought together.
    scene_cells: of a scene, at most; their heights are unknowns of one dense system.
    block_points: merged at a time; each takes about 200 bytes.
    cad_reach_mm: points farther from the CAD model are no points of the part.
    fit_capture_mm: by so much the part may stand off its planned place for the best fit to find it.
    other_relief, other_size: a model from which the cloud deviates in the median by more than these shares of its own median distance from
    a plane and of its size is that of another part. Mirrored, a part deviates by half its relief; the second share lets plates be warped.
    fit_rounds: linearisations of the best fit, at most.
    """

    points_per_scan: int = 20_000
    points_in_memory: int = 6_000_000
    spacings_per_cell: float = 6.5
    points_in_cell: int = 10
    rough: float = 2.0
    gross: float = 4.0
    rounds: int = 3
    cells: tuple[int, int] = (30, 400)
    neighbours: int = 8
    slope: float = 0.07
    captured: float = 0.1
    steps: int = 4
    coarse: tuple[float, ...] = (4.0, 2.0)
    scene_cells: int = 1500
    block_points: int = 1_000_000
    cad_reach_mm: float = 5.0
    fit_capture_mm: float = 30.0
    other_relief: float = 0.1
    other_size: float = 0.004
    fit_rounds: int = 60
