"""Columns of a linearised problem, pose by pose: of parameters that move a pose as a whole by its twist, and of the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.estimation.own_columns import OwnColumns

WIDE = 24  # functions of one direction from which their products are made from these, not from the columns


@dataclass(frozen=True)
class WideColumns:
    """Columns (P, u, k) that move a pose in one direction (P, u), by functions (P, k). place: of these among all twists.

    Their products with other columns are sums over poses of the functions by one number for each pose: a sixth of the work.
    """

    place: slice
    direction: np.ndarray
    functions: np.ndarray

    def of_poses(self, poses: slice) -> WideColumns:
        return WideColumns(self.place, self.direction[poses], self.functions[poses])


@dataclass(frozen=True)
class PoseColumns:
    """A linearised problem, pose by pose in the order of ``PoseRows``.

    basis: (P, B R, u) derivative of a pose's rows by its twist. twists: (P, u, f) of the first f parameters; station: (P, u, 6) of the
    pose's own station; joints: (P, u, n) of the joints. own: the e columns of the other parameters. residual: (P, B R). by_rows: whether
    the first columns of the basis are the rows themselves, so that any column is a twist. wide: which of the twists are made of few
    directions and many functions.
    """

    basis: np.ndarray
    twists: np.ndarray
    station: np.ndarray
    joints: np.ndarray
    own: OwnColumns
    residual: np.ndarray
    by_rows: bool = False
    wide: tuple[WideColumns, ...] = ()

    def of_poses(self, poses: slice) -> PoseColumns:
        """Those of some poses that follow each other; no array is copied."""
        arrays = self.basis[poses], self.twists[poses], self.station[poses], self.joints[poses]
        wide = tuple(one.of_poses(poses) for one in self.wide)
        return PoseColumns(*arrays, self.own.of_poses(poses), self.residual[poses], self.by_rows, wide)

    @property
    def size(self) -> int:
        """Number of parameters g = f + e."""
        return self.twists.shape[2] + self.own.size

    @property
    def of_parameters(self) -> np.ndarray:
        """(P, B R, g)."""
        return np.concatenate([self.basis @ self.twists, self.own.dense], axis=2)

    @property
    def of_station(self) -> np.ndarray:
        """(P, B R, 6) of the pose's own station."""
        return self.basis @ self.station

    @property
    def of_joints(self) -> np.ndarray:
        """(P, B R, n)."""
        return self.basis @ self.joints

    @property
    def dense(self) -> np.ndarray:
        """(P, B R, g + 7) columns of the parameters, of the pose's own station (6), and the residual (1)."""
        return np.concatenate([self.of_parameters, self.of_station, self.residual[..., None]], axis=2)

    def with_parameters(self, columns: np.ndarray) -> PoseColumns:
        """The same with further parameters, of which these are the columns (P, B R, k)."""
        if self.by_rows and not self.own.size:
            further = self.basis.shape[2] - columns.shape[1]
            return replace(self, twists=np.concatenate([self.twists, np.pad(columns, [(0, 0), (0, further), (0, 0)])], axis=2))
        return replace(self, own=replace(self.own, other=np.concatenate([self.own.other, columns], axis=2)))

    def with_twists(self, twists: np.ndarray) -> PoseColumns:
        """The same with further parameters (P, u, k), each of which moves a pose by a twist; they come after the first f."""
        return replace(self, twists=np.concatenate([self.twists, twists], axis=2))

    def with_noise(self, columns: np.ndarray) -> PoseColumns:
        """The same with further noise of each pose: columns (P, B R, k) are taken as those of the joints are."""
        assert not self.wide, "effects are beside further noise only where none of them is wide"
        k = columns.shape[2]
        added = [(0, 0), (0, k), (0, 0)]
        own = np.broadcast_to(np.eye(self.basis.shape[2] + k)[:, -k:], (len(columns), self.basis.shape[2] + k, k))
        return replace(
            self,
            basis=np.concatenate([self.basis, columns], axis=2),
            twists=np.pad(self.twists, added),
            station=np.pad(self.station, added),
            joints=np.concatenate([np.pad(self.joints, added), own], axis=2),
        )

    def change(self, step: np.ndarray, station_step: np.ndarray) -> np.ndarray:
        """(P, B R): what a step (g,) of the parameters and twists (P, 6) of the poses' stations take off the residual."""
        f = self.twists.shape[2]
        twist = self.twists @ step[:f] + (self.station @ station_step[..., None])[..., 0]
        return (self.basis @ twist[..., None])[..., 0] + self.own.change(step[f:])
