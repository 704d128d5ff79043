"""Columns of a linearised problem, pose by pose: of parameters that move a pose as a whole by its twist, and own columns of the others
(the shifts of the balls, of which each centre has one, and effects)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

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
    pose's own station; joints: (P, u, n) of the joints. own: the e columns of the other parameters. residual: (P, B R). by_rows: the
    first columns of the basis are the rows themselves, so that any column is a twist. wide: twists of few directions and many functions.
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
        """Columns of a contiguous range of poses; no array is copied."""
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
        basis, joints = (np.concatenate(pair, axis=2) for pair in ([self.basis, columns], [np.pad(self.joints, added), own]))
        return replace(self, basis=basis, twists=np.pad(self.twists, added), station=np.pad(self.station, added), joints=joints)

    def change(self, step: np.ndarray, station_step: np.ndarray) -> np.ndarray:
        """(P, B R): what a step (g,) of the parameters and twists (P, 6) of the poses' stations take off the residual."""
        f = self.twists.shape[2]
        twist = self.twists @ step[:f] + (self.station @ station_step[..., None])[..., 0]
        return (self.basis @ twist[..., None])[..., 0] + self.own.change(step[f:])


@dataclass(frozen=True)
class OwnColumns:
    """e = 3 k + t columns of the P poses, each with B slots for centres of R rows, as in ``PoseRows``.

    turn: (P, R, 3) derivative of a centre's rows by the shift of its ball; it is the same for all centres of a pose. ball: (P, B) which of
    the k free balls a centre is, k where it is none. k: number of free balls. other: (P, B R, t) columns of effects.
    """

    turn: np.ndarray
    ball: np.ndarray
    k: int
    other: np.ndarray

    def of_poses(self, poses: slice) -> OwnColumns:
        return OwnColumns(self.turn[poses], self.ball[poses], self.k, self.other[poses])

    @property
    def size(self) -> int:
        return 3 * self.k + self.other.shape[2]

    @cached_property
    def in_order(self) -> bool:
        """Whether every pose shows every ball once, in order."""
        return self.ball.shape[1] == self.k and bool(np.all(self.ball == np.arange(self.k)))

    @cached_property
    def shown(self) -> np.ndarray:
        """(P, k, B) one where a centre is of a ball; a pose may show a ball twice."""
        return (self.ball[:, None] == np.arange(self.k)[:, None]).astype(float)

    @property
    def dense(self) -> np.ndarray:
        """(P, B R, e)."""
        (P, B), R = self.ball.shape, self.turn.shape[1]
        out = np.zeros((P, B, self.k + 1, R, 3))
        out[np.arange(P)[:, None], np.arange(B), self.ball] = self.turn[:, None]
        balls = np.moveaxis(out[:, :, : self.k], 2, 3).reshape(P, B * R, 3 * self.k)
        return np.concatenate([balls, self.other], axis=2)

    def change(self, step: np.ndarray) -> np.ndarray:
        """(P, B R): the columns times a step (e,)."""
        n = 3 * self.k
        shift = np.concatenate([step[:n].reshape(self.k, 3), np.zeros((1, 3))])[self.ball]
        out = (shift @ np.swapaxes(self.turn, 1, 2)).reshape(len(shift), -1)
        return out + self.other @ step[n:] if self.other.shape[2] else out

    def by_ball(self, values: np.ndarray) -> np.ndarray:
        """(P, R, k, ...): sums of values (P, R, B, ...) over the centres of each ball."""
        if self.in_order:
            return values
        if values.ndim == 3:
            return values @ np.swapaxes(self.shown, 1, 2)
        return self.shown[:, None] @ values


class WeightedOwnColumns:
    """Own columns under weights of the centres and poses, axis by axis (P, R, B, ...), before any noise.

    scale: (P, R, B) of the rows. G: (P, R, B, u) scaled rows by the twist of the pose. share: (P,) 0 or 1. precision, below, is (R,), of
    each axis.
    """

    def __init__(self, columns: OwnColumns, scale: np.ndarray, G: np.ndarray, share: np.ndarray):
        P, R, B, u = G.shape
        self.columns, self.k, self.scale, self.share = columns, columns.k, scale, share
        t = columns.other.shape[2]
        self.other = columns.other.reshape(P, B, R, t).transpose(0, 2, 1, 3) * scale[..., None] if t else np.zeros((P, R, B, 0))
        by_axis = np.moveaxis(self.other * share[:, None, None, None], 1, 0).reshape(R, P * B, t)
        self.others_squared = np.swapaxes(by_axis, 1, 2) @ by_axis  # (R, t, t)
        self.G = G
        if self.k:
            turn = columns.turn
            twice = columns.by_ball(G * scale[..., None])  # (P, R, k, u)
            self.twice = np.ascontiguousarray(twice.transpose(0, 3, 2, 1)).reshape(P, u * self.k, R)
            each = columns.by_ball(scale**2) * share[:, None, None]
            outer = (turn[..., :, None] * turn[..., None, :]).reshape(P, R, 9)
            self.squares = np.stack([each[:, a].T @ outer[:, a] for a in range(R)])  # (R, k, 9): of each ball

    def by_twist(self, precision: np.ndarray) -> np.ndarray:
        """(P, u, e): products of the rows' derivatives by the twist with the columns."""
        P, R, B, u = self.G.shape
        parts = []
        if self.k:
            parts.append((self.twice @ (self.columns.turn * precision[:, None])).reshape(P, u, 3 * self.k))
        if self.other.shape[3]:
            rows = (self.G * precision[:, None, None]).reshape(P, R * B, u)
            parts.append(np.swapaxes(rows, 1, 2) @ self.other.reshape(P, R * B, -1))
        return parts[0] if len(parts) == 1 else np.concatenate([*parts, np.zeros((P, u, 0))], axis=2)

    def gram(self, precision: np.ndarray) -> np.ndarray:
        """(e, e): products of the columns."""
        n, t = 3 * self.k, self.other.shape[3]
        out = np.zeros((n + t, n + t))
        if n:
            place = np.arange(n).reshape(self.k, 3)
            out[place[:, :, None], place[:, None, :]] = np.tensordot(precision, self.squares, 1).reshape(self.k, 3, 3)
        if t:
            weighted = self.other * (self.share[:, None, None, None] * precision[:, None, None])
            out[n:, n:] = np.tensordot(precision, self.others_squared, 1)
            if n:
                mixed = self.columns.by_ball(weighted * self.scale[..., None])
                out[:n, n:] = np.einsum("prkt,prc->kct", mixed, self.columns.turn).reshape(n, t)
                out[n:, :n] = out[:n, n:].T
        return out

    def product(self, rows: np.ndarray) -> np.ndarray:
        """(e, R): the columns' products with rows (P, R, B), axis by axis."""
        R, parts = rows.shape[1], []
        if self.k:
            each = self.columns.by_ball(rows * self.scale)
            turn = self.columns.turn
            parts.append(np.stack([(each[:, a].T @ turn[:, a]).ravel() for a in range(R)], axis=1))
        if self.other.shape[3]:
            parts.append(np.einsum("prbt,prb->tr", self.other, rows))
        return np.concatenate([*parts, np.zeros((0, R))])

    def variance(self, mixed: np.ndarray, own: np.ndarray) -> np.ndarray:
        """(R,) sums over the rows of each axis of what the columns add to the variance of rows G y, y (u,) the twist of a pose: twice the
        covariance of G y with the columns' part, and the variance of that. mixed: (P, u, e) covariance of y and the own parameters, own:
        (e, e) of these."""
        n, t = 3 * self.k, self.other.shape[3]
        P, R, B, u = self.G.shape
        out = np.zeros(R)
        if n:
            place = np.arange(n).reshape(self.k, 3)
            out += self.squares.reshape(R, -1) @ own[place[:, :, None], place[:, None, :]].ravel()
            with_ball = (mixed[..., :n] * self.share[:, None, None]).reshape(P, u * self.k, 3)
            against = np.swapaxes(self.twice, 1, 2) @ with_ball  # (P, R, 3)
            out += 2 * np.einsum("prc,prc->r", against, self.columns.turn)
        if t:
            other = self.other * self.share[:, None, None, None]
            rows = self.G.reshape(P, R * B, u) @ mixed[..., n:]
            out += self.others_squared.reshape(R, -1) @ own[n:, n:].ravel() + 2 * np.einsum("prbt,prbt->r", rows.reshape(P, R, B, t), other)
            if n:
                sums = np.einsum("prkt,prc->rkct", self.columns.by_ball(other * self.scale[..., None]), self.columns.turn)
                out += 2 * sums.reshape(R, -1) @ own[:n, n:].ravel()
        return out
