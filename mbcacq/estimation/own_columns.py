"""Columns of parameters that do not move a pose as a whole: the shifts of the balls, of which each centre has one, and effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class OwnColumns:
    """e = 3 k + t columns, rows grouped by pose as in ``PoseRows``.

    shift: (P, B R, 3) derivative of each row by the shift of its own ball. ball: (P, B) which of the k free balls a centre is, k where
    it is none. k: number of free balls. other: (P, B R, t) columns of effects.
    """

    shift: np.ndarray
    ball: np.ndarray
    k: int
    other: np.ndarray

    @property
    def size(self) -> int:
        return 3 * self.k + self.other.shape[2]

    @property
    def _by_centre(self) -> np.ndarray:
        """(P, B, R, 3)."""
        return self.shift.reshape(*self.ball.shape, -1, 3)

    @cached_property
    def _in_order(self) -> bool:
        """Whether every pose shows every ball once, in order."""
        return self.ball.shape[1] == self.k and bool(np.all(self.ball == np.arange(self.k)))

    def scaled(self, scale: np.ndarray) -> OwnColumns:
        """Rows times scale (P, B R)."""
        return replace(self, shift=self.shift * scale[..., None], other=self.other * scale[..., None])

    @property
    def dense(self) -> np.ndarray:
        """(P, B R, e)."""
        P, B = self.ball.shape
        out = np.zeros((P, B, self.k + 1, self.shift.shape[1] // max(B, 1), 3))
        out[np.arange(P)[:, None], np.arange(B), self.ball] = self._by_centre
        balls = np.moveaxis(out[:, :, : self.k], 2, 3).reshape(P, self.shift.shape[1], 3 * self.k)
        return np.concatenate([balls, self.other], axis=2)

    def by_twist(self, G: np.ndarray) -> np.ndarray:
        """(P, u, e): G' times the columns, G (P, B R, u)."""
        Gt = np.swapaxes(G, 1, 2)
        if not self.k:
            return Gt @ self.other
        P, B = self.ball.shape
        single = np.swapaxes(self._by_centre, 2, 3) @ G.reshape(P, B, -1, G.shape[2])  # (P, B, 3, u)
        if self._in_order:
            balls = np.ascontiguousarray(np.moveaxis(single, 3, 1)).reshape(P, -1, 3 * self.k)
            return np.concatenate([balls, Gt @ self.other], axis=2) if self.other.shape[2] else balls
        out = np.zeros((P, self.k + 1, 3, G.shape[2]))
        for b in range(B):  # a pose may show a ball twice
            out[np.arange(P), self.ball[:, b]] += single[:, b]
        balls = np.swapaxes(out[:, : self.k].reshape(P, 3 * self.k, -1), 1, 2)
        return np.concatenate([balls, Gt @ self.other], axis=2) if self.other.shape[2] else np.ascontiguousarray(balls)

    def gram(self, share: np.ndarray) -> np.ndarray:
        """(e, e): products of the columns, poses weighted with share (P,)."""
        out = np.zeros((self.size, self.size))
        E, other, n = self._by_centre, self.other, 3 * self.k
        weighted = E * share[:, None, None, None]
        if n:
            square = self._sum_by_ball(np.swapaxes(E, 2, 3) @ weighted)
            place = np.arange(n).reshape(self.k, 3)
            out[place[:, :, None], place[:, None, :]] = square
        if t := other.shape[2]:
            flat = other.reshape(-1, t)
            out[n:, n:] = flat.T @ (other * share[:, None, None]).reshape(-1, t)
            if n:
                mixed = np.swapaxes(weighted, 2, 3) @ other.reshape(*E.shape[:3], t)
                out[:n, n:] = self._sum_by_ball(mixed).reshape(n, t)
                out[n:, :n] = out[:n, n:].T
        return out

    def product(self, rows: np.ndarray) -> np.ndarray:
        """(e, m): the columns' products with rows (P, B R, m)."""
        m = rows.shape[2]
        other = np.tensordot(self.other, rows, axes=([0, 1], [0, 1]))
        if not self.k:
            return other
        E = self._by_centre
        balls = self._sum_by_ball(np.swapaxes(E, 2, 3) @ rows.reshape(*E.shape[:3], m))
        return np.concatenate([balls.reshape(3 * self.k, m), other])

    def _sum_by_ball(self, values: np.ndarray) -> np.ndarray:
        """(k, 3, m): sums of values (P, B, 3, m) over the centres of each ball."""
        if self._in_order:
            return values.sum(axis=0)
        flat = values.reshape(self.ball.size, -1)
        ball = self.ball.ravel()
        summed = np.stack([np.bincount(ball, column, self.k + 1) for column in flat.T], axis=1)
        return summed[: self.k].reshape(self.k, *values.shape[2:])

    def change(self, step: np.ndarray) -> np.ndarray:
        """(P, B R): the columns times a step (e,)."""
        n = 3 * self.k
        shift = np.concatenate([step[:n].reshape(self.k, 3), np.zeros((1, 3))])[self.ball]
        return (self._by_centre @ shift[..., None]).reshape(self.shift.shape[:2]) + self.other @ step[n:]

    def variance(self, G: np.ndarray, mixed: np.ndarray, own: np.ndarray) -> np.ndarray:
        """(P, B R): what the columns add to the variance of rows G y, y (u,) the twist of a pose: twice the covariance of G y with the
        columns' part, and the variance of that. mixed: (P, u, e) covariance of y and the own parameters, own: (e, e) of these."""
        E, n = self._by_centre, 3 * self.k
        out = np.zeros(self.shift.shape[:2])
        if n:
            P, B = self.ball.shape
            with_ball = np.zeros((P, self.k + 1, G.shape[2], 3))
            with_ball[:, : self.k] = np.swapaxes(mixed[..., :n].reshape(P, -1, self.k, 3), 1, 2)
            here = with_ball[np.arange(P)[:, None], self.ball]  # (P, B, u, 3)
            place = np.arange(n).reshape(self.k, 3)
            of_ball = np.concatenate([own[place[:, :, None], place[:, None, :]], np.zeros((1, 3, 3))])[self.ball]
            out += np.sum((2 * G.reshape(P, B, -1, G.shape[2]) @ here + E @ of_ball) * E, axis=3).reshape(out.shape)
        if t := self.other.shape[2]:
            against = 2 * G @ mixed[..., n:] + self.other @ own[n:, n:]
            if n:
                between = np.concatenate([own[:n, n:].reshape(self.k, 3, t), np.zeros((1, 3, t))])[self.ball]
                against += 2 * (E @ between).reshape(against.shape)
            out += np.sum(against * self.other, axis=2)
        return out
