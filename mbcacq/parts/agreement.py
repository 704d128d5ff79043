"""How well the scans of a part agree where they overlap: before the calibration, by geometry, with effects, beside what is expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import Overlap, cells_of, overlap
from mbcacq.parts.placement import CellPlacement
from mbcacq.parts.scans import PartScan, ScanSurface, spacing
from mbcacq.parts.step import RigidStep, SmoothNoise, rigid_step, smooth_noise

CLEAR = 2.0  # times what is expected: so much disagreement needs an explanation


@dataclass(frozen=True)
class PairOfScans:
    """A pair of scans: the numbers of their poses, and by how much they disagree over their overlap (3D rms, mm).

    by_placement: name -> mm. expected_mm: of the last placement, k = 1. normalised: squared step over its covariance, per determined
    direction.
    """

    poses: tuple[int, int]
    step: RigidStep
    by_placement: dict[str, float]
    expected_mm: float
    normalised: float

    def to_dict(self) -> dict[str, Any]:
        step = self.step
        return {
            "poses": list(self.poses),
            "cells": len(step.cells),
            "cells_left_out": step.left_out,
            "mm": self.by_placement,
            "expected_mm": self.expected_mm,
            "normalised": self.normalised,
            "undetermined": step.undetermined,
            "centre_mm": step.centre.tolist(),
            "step": {"mm": step.twist[:3].tolist(), "rad": step.twist[3:].tolist()},
            "covariance": step.covariance.tolist(),
        }


@dataclass(frozen=True)
class Agreement:
    """The agreement of all pairs of scans that overlap enough.

    Attributes
    ----------
    names : tuple[str, ...]
        The placements, the best last.
    noise : SmoothNoise
        The smooth noise of the distance of two scans, estimated from their overlaps.
    scatter_mm : float
        Scatter of a point about the surface, where that is smooth.
    """

    names: tuple[str, ...]
    pairs: tuple[PairOfScans, ...]
    noise: SmoothNoise
    scatter_mm: float
    alone: tuple[int, ...] = ()  # poses whose scans overlap with no other

    def rms_mm(self, name: str) -> float:
        """Over all pairs, 3D."""
        return float(np.sqrt(np.mean([pair.by_placement[name] ** 2 for pair in self.pairs])))

    @property
    def expected_mm(self) -> float:
        return float(np.sqrt(np.mean([pair.expected_mm**2 for pair in self.pairs])))

    @property
    def ratio(self) -> float:
        """What the best placement leaves over what is expected."""
        return self.rms_mm(self.names[-1]) / self.expected_mm

    @property
    def sentence(self) -> str:
        before = self.rms_mm(self.names[0])
        text = (
            f"the scans of this part agree within {self.rms_mm(self.names[-1]):.3f} mm (3D rms of {len(self.pairs)} overlaps; expected "
            f"{self.expected_mm:.3f}); before calibration {before:.2f}"
        )
        if self.ratio > CLEAR:
            text += "; that is more than the calibration explains: the part, the mount or the arm moved, or an effect is missing"
        return text

    def to_dict(self) -> dict[str, Any]:
        return {
            "sentence": self.sentence,
            "rms_mm": {name: self.rms_mm(name) for name in self.names},
            "expected_mm": self.expected_mm,
            "ratio": self.ratio,
            "smooth_noise_mm": self.noise.sigma_mm / np.sqrt(2),
            "smooth_noise_length_mm": self.noise.length_mm,
            "scatter_mm": self.scatter_mm,
            "alone": list(self.alone),
            "pairs": [pair.to_dict() for pair in self.pairs],
        }


@dataclass(frozen=True)
class _Placed:
    """A thinned scan: with its surface in the scanner frame, and its points and normals in the base frame by the best placement."""

    scan: PartScan
    surface: ScanSurface
    points: np.ndarray
    normals: np.ndarray

    def moved(self, twist: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals once a step about a centre is taken back."""
        T = se3.exp(-twist)
        return se3.apply(T, self.points - centre) + centre, self.normals @ T[:3, :3].T


def agreement(scans: Sequence[tuple[PartScan, ScanSurface]], placements: Sequence[CellPlacement], options: PartOptions) -> Agreement:
    """Compare all scans that overlap. scans: thinned, with their surfaces. Raises ConfigError if no two overlap enough."""
    best = placements[-1]
    placed = [_placed(scan, surface, best) for scan, surface in scans]
    edge = options.spacings_per_cell * spacing(placed[0].points)
    pairs = _pairs(placed, edge, options)
    near = [(i, j, *_in_place(placed[i], placed[j], edge, options)) for i, j in pairs]
    near = [one for one in near if len(one[2]) >= options.cells[0]]
    if not near:
        raise ConfigError("no two scans of this part overlap enough to be compared; scan it with views that share a third of what they see")
    noise = smooth_noise([cells for _, _, cells, *_ in near], options)
    found = tuple(_pair(placed[i], placed[j], cells, base, noise, placements, options) for i, j, cells, base in near)
    used = {pose for pair in found for pose in pair.poses}
    # Where the part is smooth, the scatter is the scanner's own.
    scatter = float(np.quantile(np.concatenate([pair.step.cells.scatter for pair in found]), 0.25))
    alone = tuple(one.scan.number for one in placed if one.scan.number not in used)
    return Agreement(tuple(p.name for p in placements), found, noise, scatter, alone)


def _placed(scan: PartScan, surface: ScanSurface, best: CellPlacement) -> _Placed:
    points = best.to_base(scan.q, surface.points)
    rotation = (best.cell.frames(scan.q[None])[0, -1] @ best.cell.state.T_flange_scanner)[:3, :3]
    return _Placed(scan, surface, points, surface.normals @ rotation.T)


def _pairs(placed: Sequence[_Placed], edge: float, options: PartOptions) -> list[tuple[int, int]]:
    """Pairs that share most cells: of each scan its largest overlaps."""
    from scipy.sparse import csr_array

    keys = [np.unique(cells_of(one.points, edge)) for one in placed]
    column = np.unique(np.concatenate(keys), return_inverse=True)[1]
    row = np.repeat(np.arange(len(keys)), [len(k) for k in keys])
    occupied = csr_array((np.ones(len(row), np.int32), (row, column)))
    shared = (occupied @ occupied.T).toarray()
    np.fill_diagonal(shared, 0)
    out = set()
    for i, line in enumerate(shared):
        for j in np.argsort(line)[::-1][: options.neighbours]:
            if line[j] >= options.cells[0]:
                out.add((min(i, int(j)), max(i, int(j))))
    return sorted(out)


def _in_place(a: _Placed, b: _Placed, edge: float, options: PartOptions) -> tuple[Overlap, tuple[np.ndarray, np.ndarray]]:
    """Their overlap once the first was brought onto the second, and the motion (twist, centre) that did so.

    The distances are then small against the cells, and what was taken back is a step like any other.
    """
    plain, twist, centre = SmoothNoise(0.0, 1.0), np.zeros(6), np.concatenate([a.points, b.points]).mean(axis=0)
    cells = overlap((a.points, a.normals), (b.points, b.normals), edge, options)
    for _ in range(options.steps):
        if len(cells) < options.cells[0] or float(np.sqrt(np.mean(cells.distance**2))) < options.captured * edge / 2:
            break
        step = rigid_step(cells, plain, options)
        turn = step.twist[3:]
        twist = twist + np.concatenate([step.twist[:3] + np.cross(turn, centre - step.centre), turn])
        cells = overlap(a.moved(twist, centre), (b.points, b.normals), edge, options)
    return cells, (twist, centre)


def _pair(
    a: _Placed,
    b: _Placed,
    cells: Overlap,
    base: tuple[np.ndarray, np.ndarray],
    noise: SmoothNoise,
    placements: Sequence[CellPlacement],
    options: PartOptions,
) -> PairOfScans:
    step = rigid_step(cells, noise, options)
    taken, at = base
    back = np.concatenate([taken[:3] + np.cross(taken[3:], step.centre - at), taken[3:]])
    step = replace(step, twist=step.shown(step.twist + back))
    best = placements[-1]
    corners = [_corners(one, step.cells.point, best) for one in (a, b)]
    both = list(zip((a, b), corners, strict=True))
    (of_a, joints_a), (of_b, joints_b) = (best.twist_columns(one.scan.q, xyz, step.centre) for one, xyz in both)
    difference = of_a - of_b
    covariance = difference @ best.cell.covariance @ difference.T + joints_a @ joints_a.T + joints_b @ joints_b.T + step.covariance
    by_placement = {}
    for placement in placements:
        moves = [_nearest_motion(placement, best, one.scan.q, xyz, step.centre) for one, xyz in both]
        by_placement[placement.name] = step.rms_mm(step.twist + moves[0] - moves[1])
    poses = (a.scan.number, b.scan.number)
    return PairOfScans(poses, step, by_placement, step.expected_mm(covariance), step.normalised(covariance))


def _corners(one: _Placed, cells: np.ndarray, best: CellPlacement) -> np.ndarray:
    """(8, 3) mm corners of the overlap's box in the scanner frame of a scan."""
    T = best.cell.frames(one.scan.q[None])[0, -1] @ best.cell.state.T_flange_scanner
    seen = se3.apply(se3.inverse(T), cells)
    low, high = seen.min(axis=0), seen.max(axis=0)
    low[2], high[2] = low[2] - 5.0, high[2] + 5.0  # a flat overlap still has a box
    corner = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T
    return low + corner * (high - low)


def _nearest_motion(placement: CellPlacement, best: CellPlacement, q: np.ndarray, xyz: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Twist (6,) about a centre that is nearest to what a placement does to points, beside the best one."""
    if placement is best:
        return np.zeros(6)
    before, after = placement.to_base(q, xyz), best.to_base(q, xyz)
    T = se3.fit_rigid_transforms(after - centre, before - centre, np.zeros(len(xyz), dtype=int), 1)[0]
    return np.concatenate([T[:3, 3], se3.rotation_log(T[:3, :3])])
