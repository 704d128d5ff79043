"""Where a calibrated cell puts the points of a scan, and how well it knows that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.geometry import se3

CHUNK = 200_000
GRID = 3  # control points along each side of a scan's box, between which covariances are interpolated
_PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]  # elements of a symmetric matrix


@dataclass(frozen=True)
class CellPlacement:
    """A way to place scans: name, and the cell that does it."""

    name: str
    cell: CalibratedCell

    def frame(self, q: np.ndarray) -> np.ndarray:
        """T_base_scanner (4, 4) at joints q (n,)."""
        return self.cell.frames(q[None])[0, -1] @ self.cell.state.T_flange_scanner

    def to_base(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Points (N, 3) mm seen at joints q (n,) in the base frame, effects included."""
        out = np.empty((len(xyz), 3))
        T = self.frame(q)
        for start in range(0, len(xyz), CHUNK):
            some = xyz[start : start + CHUNK].astype(float)
            if self.cell.effects:
                some = self.cell.corrected_points(np.broadcast_to(q, (len(some), len(q))), some)
            out[start : start + CHUNK] = se3.apply(T, some)
        return out

    def twist_columns(self, q: np.ndarray, xyz: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How the cell's parameters (6, g) and one sigma of each joint (6, n) move a scan as a whole.

        Rows: shift in mm and rotation vector in rad, base frame, about ``centre`` (3,) mm. It is the rigid motion that is nearest to what
        happens at points xyz (k, 3) of the scan, scanner frame.
        """
        cell, at = self.cell, self.to_base(q, xyz)
        D = rigid_columns(at - centre).reshape(-1, 6)
        moved = cell.point_columns(np.broadcast_to(q, (len(xyz), len(q))), xyz)
        chain = cell.state.chain
        twists = chain.joint_twists(chain.frames(q[None]))[0] * cell.noise.joint[: chain.n, None]  # about the base's origin
        joints = np.hstack([twists[:, :3] + np.cross(twists[:, 3:], centre), twists[:, 3:]]).T
        return np.linalg.lstsq(D, moved.reshape(-1, moved.shape[2]), rcond=None)[0], joints

    def covariance_over(self, q: np.ndarray, xyz: np.ndarray, common: CommonMotion | None = None) -> CovarianceField:
        """Covariance of the places of a scan's points xyz (N, 3), scanner frame, by parameters and joints.

        Without ``common`` in the base frame; with it, relative to all scans of the part together.
        """
        low, high = xyz.min(axis=0).astype(float), xyz.max(axis=0).astype(float)
        axes = [np.linspace(a, max(b, a + 1.0), GRID) for a, b in zip(low, high, strict=True)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        placed, columns = self.to_base(q, nodes), self.cell.point_columns(np.broadcast_to(q, (len(nodes), len(q))), nodes)
        if common is not None:
            columns = columns - rigid_columns(placed - common.centre) @ common.columns
        known = columns @ self.cell.covariance @ np.swapaxes(columns, 1, 2)
        chain = self.cell.state.chain
        twists = chain.joint_twists(chain.frames(q[None]))[0] * self.cell.noise.joint[: chain.n, None]
        moved = twists[None, :, :3] + np.cross(twists[None, :, 3:], placed[:, None])  # (nodes, n, 3)
        total = known + np.einsum("knc,knd->kcd", moved, moved)
        return CovarianceField(axes, np.stack([total[:, i, j] for i, j in _PAIRS], axis=1).reshape(GRID, GRID, GRID, 6))


@dataclass(frozen=True)
class CommonMotion:
    """How the cell's parameters move all scans of a part together: (6, g) about ``centre`` (3,) mm, base frame."""

    columns: np.ndarray
    centre: np.ndarray

    @classmethod
    def of(cls, placement: CellPlacement, scans: Sequence[tuple[np.ndarray, np.ndarray]]) -> CommonMotion:
        """The mean over scans, each given by its joints (n,) and some points (k, 3) in the scanner frame."""
        centre = np.mean([placement.to_base(q, xyz).mean(axis=0) for q, xyz in scans], axis=0)
        return cls(np.mean([placement.twist_columns(q, xyz, centre)[0] for q, xyz in scans], axis=0), centre)


@dataclass(frozen=True)
class CovarianceField:
    """Covariances mm^2, base frame, on a grid over a scan; axes: of the grid, scanner frame; values (k, k, k, 6)."""

    axes: list[np.ndarray]
    values: np.ndarray

    def variance_along(self, xyz: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(N,) mm^2 at points xyz (N, 3), scanner frame, along unit vectors (N, 3) of the base frame."""
        from scipy.interpolate import RegularGridInterpolator

        low, high = np.array([[axis[0], axis[-1]] for axis in self.axes]).T
        found = RegularGridInterpolator(self.axes, self.values)(np.clip(xyz, low, high))
        weights = np.stack([direction[:, i] * direction[:, j] * (1 if i == j else 2) for i, j in _PAIRS], axis=1)
        return np.maximum(np.einsum("nk,nk->n", found, weights), 0.0)


def placements(cell: CalibratedCell) -> list[CellPlacement]:
    """The ways that are compared: before the calibration, by geometry, and with effects where the cell has some. The last is the best."""
    nothing = replace(cell, state=cell.preliminary, effects=None)
    out = [CellPlacement("before", nothing), CellPlacement("geometry", replace(cell, effects=None))]
    return [*out, CellPlacement("effects", cell)] if cell.effects else out


def rigid_columns(arms: np.ndarray) -> np.ndarray:
    """(k, 3, 6): movement of points at arms (k, 3) mm from the centre by shift and rotation vector."""
    return np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), -se3.skew(arms)], axis=2)
