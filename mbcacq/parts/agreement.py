"""How well the scans of a part agree where they overlap: before the calibration, by geometry, with effects, beside what is expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.geometry import se3
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import SurfaceCells, surface_cells
from mbcacq.parts.placement import CellPlacement
from mbcacq.parts.scans import PartScan, ScanSurface
from mbcacq.parts.scene import brought_together, cell_edge
from mbcacq.parts.step import RigidStep, SmoothNoise, in_words, motions, rigid_step

CLEAR = 2.0  # times what is expected: so much disagreement needs an explanation


@dataclass(frozen=True)
class PairOfScans:
    """A pair of scans: the numbers of their poses, and by how much they disagree over their overlap (3D rms, mm).

    by_placement: name -> mm. expected_mm: of the last placement, k = 1. normalised: name -> squared step over the covariance that the last
    placement states, per determined direction.
    """

    poses: tuple[int, int]
    step: RigidStep
    by_placement: dict[str, float]
    expected_mm: float
    normalised: dict[str, float]

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
    undetermined: tuple[str, ...] = ()  # motions of scans that no overlap shows, in words
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
        if self.undetermined:
            text += f"; no overlap determines the motions {', '.join(self.undetermined)}"
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
            "undetermined": list(self.undetermined),
            "alone": list(self.alone),
            "pairs": [pair.to_dict() for pair in self.pairs],
        }


def agreement(scans: Sequence[ScanSurface], placements: Sequence[CellPlacement], options: PartOptions) -> Agreement:
    """Compare all scans that overlap, thinned, once all are brought together. Raises ConfigError if no two overlap enough."""
    best = placements[-1]
    T = np.stack([best.frame(scan.q) for scan in scans])
    # As the effects have their points.
    back = se3.inverse(T)
    placed = [replace(scan, points=se3.apply(M, best.to_base(scan.q, scan.points))) for M, scan in zip(back, scans, strict=True)]
    together = brought_together(placed, T, options)
    cells, noise = together.cells, together.noise.of_two
    moved = together.T_base_scanner @ back
    found = []
    for i, j in _pairs(cells, len(scans), options):
        step = rigid_step(cells.pair(i, j), noise, options)
        taken = [np.r_[se3.apply(moved[k], step.centre) - step.centre, se3.rotation_log(moved[k, :3, :3])] for k in (i, j)]
        step = replace(step, twist=step.shown(step.twist - taken[0] + taken[1]))
        found.append(_pair([scans[k] for k in (i, j)], T[[i, j]], step, placements))
    used = {pose for pair in found for pose in pair.poses}
    # Where the part is smooth, the scatter is the scanner's own.
    scatter = float(np.quantile(np.concatenate([pair.step.cells.scatter for pair in found]), 0.25))
    alone = tuple(scan.number for scan in scans if scan.number not in used)
    centre, scale, _, _, not_shown = motions(cells.point, cells.normal, options)
    not_shown = tuple(in_words(not_shown, scale, centre))
    return Agreement(tuple(p.name for p in placements), tuple(found), noise, scatter, not_shown, alone)


def offsets(scans: Sequence[ScanSurface], placement: CellPlacement, times: float, options: PartOptions) -> np.ndarray:
    """(g, 4): middles of the cells that scans share, as each of them has it: off their mean by so many times as much (mm, base frame), and
    the index of the scan."""
    placed = [(placement.to_base(one.q, one.points), one.normals @ placement.frame(one.q)[:3, :3].T) for one in scans]
    cells = surface_cells(placed, cell_edge(scans, options), options)
    mean = np.bincount(cells.cell, cells.height) / np.bincount(cells.cell)
    off = times * (cells.height - mean[cells.cell])
    return np.column_stack([cells.point[cells.cell] + off[:, None] * cells.normal[cells.cell], cells.scan])


def _pairs(cells: SurfaceCells, count: int, options: PartOptions) -> list[tuple[int, int]]:
    """Pairs that share enough cells: of each scan its largest overlaps."""
    shared = cells.shared(count)
    np.fill_diagonal(shared, 0)
    largest = np.argsort(shared, axis=1)[:, ::-1][:, : options.neighbours]
    pairs = {(min(i, j), max(i, j)) for i, line in enumerate(largest.tolist()) for j in line if shared[i, j] >= options.cells[0]}
    return sorted(pairs)


def _pair(scans: Sequence[PartScan], T: np.ndarray, step: RigidStep, placements: Sequence[CellPlacement]) -> PairOfScans:
    """T: (2, 4, 4), of both by the best placement."""
    best = placements[-1]
    both = [(scan.q, _corners(M, step.cells.point)) for scan, M in zip(scans, T, strict=True)]
    (of_a, joints_a), (of_b, joints_b) = (best.twist_columns(q, xyz, step.centre) for q, xyz in both)
    difference = of_a - of_b
    covariance = difference @ best.cell.covariance @ difference.T + joints_a @ joints_a.T + joints_b @ joints_b.T + step.covariance
    by_placement, normalised = {}, {}
    for placement in placements:
        moves = [_nearest_motion(placement, best, q, xyz, step.centre) for q, xyz in both]
        twist = step.shown(step.twist + moves[0] - moves[1])
        by_placement[placement.name], normalised[placement.name] = step.rms_mm(twist), step.normalised(twist, covariance)
    return PairOfScans((scans[0].number, scans[1].number), step, by_placement, step.expected_mm(covariance), normalised)


def _corners(T: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(8, 3) mm corners of the overlap's box in the scanner frame of a scan."""
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
    return se3.coordinates(se3.fit_rigid_transforms(after - centre, before - centre, np.zeros(len(xyz), dtype=int), 1)[0])
