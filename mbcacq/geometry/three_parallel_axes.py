"""Inverse kinematics in closed form of six axes of which 2, 3 and 4 are parallel, as collaborative arms mostly have them.

An arm is its axes at zero: the flange moves by the product of the rotations about them. The decomposition of this family is in Elias and
Wen, "IK-Geo: unified robot inverse kinematics using subproblem decomposition", 2025. The invariants of each rotation give one angle after
the other, each by a cos x + b sin x = c (subproblems after Paden and Kahan):

1. The point P where axes 5 and 6 meet keeps its height along the parallel axes, whatever these do: q1. 2. So does the direction of axis 6,
but for q5. 3. The direction of axis 6 then gives q2 + q3 + q4, and the rest of the rotation q6. 4. The rest is a plane arm of two links:
q3, then q2 and q4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.numerical_inverse import FULL_TURN, with_full_turns

AGREEMENT = 1e-6  # mm, and rad: how well the axes must fit the family, and a branch the target
TOUCHING = 1e-9  # share by which c may exceed the root of a^2 + b^2 where the two solutions meet


@dataclass(frozen=True)
class ThreeParallelAxesInverse:
    """Solver of one arm.

    Attributes
    ----------
    chain
        The arm.
    limits
        (6, 2) rad.
    axis, point
        (6, 3) direction of each axis, the way it turns, and a point (mm) on it, at q = 0 in the base.
    meeting
        (3,) mm where axes 5 and 6 meet at q = 0.
    zero
        T_base_flange (4, 4) at q = 0.
    """

    chain: Chain
    limits: np.ndarray
    axis: np.ndarray
    point: np.ndarray
    meeting: np.ndarray
    zero: np.ndarray

    @classmethod
    def of(cls, chain: Chain, limits: np.ndarray) -> ThreeParallelAxesInverse | None:
        """The solver of an arm with limits (n, 2) rad; None if the arm is not of this family."""
        if chain.n != 6:
            return None
        frames = chain.frames(np.zeros((1, 6)))[0]
        axis, point = chain.sign[:, None] * frames[:6, :3, 2], frames[:6, :3, 3]
        parallel = np.abs(axis[[2, 3]] @ axis[1])
        square = np.abs([axis[0] @ axis[1], axis[3] @ axis[4], axis[4] @ axis[5]])
        meeting = _meeting(point[4], axis[4], point[5], axis[5])
        if np.any(parallel < 1 - AGREEMENT**2) or np.any(square > AGREEMENT) or meeting is None:
            return None
        return cls(chain, limits, axis, point, meeting, frames[6])

    def branches(self, T_base_flange: np.ndarray) -> np.ndarray:
        """Every branch of every pose.

        Parameters
        ----------
        T_base_flange : ndarray (P, 4, 4)

        Returns
        -------
        ndarray (P, 8, 6)
            rad in (-pi, pi], limits not applied; NaN where a branch does not exist, or where axis 6 is parallel to the three, so that only
            a sum of angles is determined.
        """
        n, (o1, o2, o3, o4), meeting = self.axis[1], self.point[:4], self.meeting
        moved = np.asarray(T_base_flange, dtype=float) @ se3.inverse(self.zero)
        first = _both(*self._about_first(se3.apply(moved, meeting) - o1), n @ (meeting - o1))  # (P, 2)
        G = _undone(self.axis[0], o1, first) @ moved[:, None]  # (P, 2, 4, 4)
        six, five = self.axis[5], self.axis[4]
        seen = G[..., :3, :3] @ six
        fifth = _both(np.full(first.shape, n @ six), np.full(first.shape, n @ np.cross(five, six)), seen @ n)  # (P, 2, 2)
        bent, seen = _turned(five, fifth, six), np.broadcast_to(seen[:, :, None], (*fifth.shape, 3))
        together = np.where(np.abs(bent @ n) > 1 - AGREEMENT**2, np.nan, _angle(n, bent, seen))
        back = _undone(self.axis[4], meeting, fifth)
        rotation = back[..., :3, :3] @ _rotation(n, -together) @ G[:, :, None, :3, :3]
        across = five  # any direction square to axis 6
        sixth = _angle(six, np.broadcast_to(across, seen.shape), rotation @ across)
        K = G[:, :, None] @ _undone(six, meeting, sixth) @ back
        reached = se3.apply(K, o4) - o2
        reached = reached - (reached @ n)[..., None] * n
        upper, fore = _across(n, o3 - o2), _across(n, o4 - o3)
        c = 0.5 * (np.sum(reached**2, axis=-1) - upper @ upper - fore @ fore)
        third = _both(np.full(c.shape, upper @ fore), np.full(c.shape, upper @ np.cross(n, fore)), c)  # (P, 2, 2, 2)
        second = _angle(n, upper + _turned(n, third, fore), np.broadcast_to(reached[..., None, :], (*third.shape, 3)))
        fourth = together[..., None] - second - third
        signs = np.sign(self.axis[[2, 3]] @ n)
        whole = [first[:, :, None, None], second, signs[0] * third, signs[1] * fourth, fifth[..., None], sixth[..., None]]
        q = np.stack(np.broadcast_arrays(*whole), axis=-1).reshape(len(moved), 8, 6)
        return np.pi - np.mod(np.pi - q, FULL_TURN)

    def solutions(self, T_base_flange: np.ndarray, margin: float = 0.0) -> list[np.ndarray]:
        """All joint positions within the limits less ``margin`` (rad), full turns included: per pose (P, 4, 4) (k, 6) rad, k may be 0."""
        targets = np.asarray(T_base_flange, dtype=float)
        low, high = self.limits[:, 0] + margin, self.limits[:, 1] - margin
        every = self.branches(targets)
        pose, branch = np.nonzero(np.isfinite(every).all(axis=2))
        q = every[pose, branch]
        away = np.abs(self.chain.flange(q) - targets[pose])
        lever = np.maximum(1.0, np.abs(targets[pose, :3, 3]).max(axis=1, initial=0.0))
        right = (away[:, :3, :3].max(axis=(1, 2)) < AGREEMENT) & (away[:, :3, 3].max(axis=1) < AGREEMENT * lever)
        each = [with_full_turns(q[right & (pose == k)], low, high) for k in range(len(targets))]
        return [one[np.unique(one.round(9), axis=0, return_index=True)[1]] for one in each]  # two branches are one where they meet

    def nearest(self, T_base_flange: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The solution (6,) rad at a pose (4, 4) that is closest to ``q`` (6,), or None."""
        found = self.solutions(np.asarray(T_base_flange)[None])[0]
        return found[np.argmin(np.abs(found - q).max(axis=1))] if len(found) else None

    def _about_first(self, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """a, b (P,) of n . R(-q1) lever = a cos q1 + b sin q1; lever: (P, 3). What lies along axis 1 is square to n."""
        n = self.axis[1]
        return lever @ n, np.cross(self.axis[0], n) @ lever.T


def _meeting(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray | None:
    """(3,) mm where two lines that are not parallel meet; None if they do not."""
    if abs(u @ v) > 0.5:
        return None
    s, t = np.linalg.lstsq(np.stack([u, -v], axis=1), q - p, rcond=None)[0]
    return p + s * u if np.linalg.norm(p + s * u - q - t * v) < AGREEMENT else None


def _both(a: np.ndarray, b: np.ndarray, c: np.ndarray | float) -> np.ndarray:
    """(..., 2) both x with a cos x + b sin x = c; NaN where there is none."""
    size = np.hypot(a, b)
    share = np.asarray(c) / np.maximum(size, 1e-300)
    share = np.where(np.abs(share) > 1 + TOUCHING, np.nan, np.clip(share, -1.0, 1.0))
    away = np.arccos(share)
    return np.arctan2(b, a)[..., None] + np.stack([away, -away], axis=-1)


def _rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations about a unit vector (Rodrigues)."""
    K = se3.skew(axis)
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


def _undone(axis: np.ndarray, point: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(..., 4, 4) rotations back by angles about a line."""
    R = _rotation(axis, -angle)
    return se3.transform(R, point - R @ point)


def _turned(axis: np.ndarray, angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(..., 3) a vector turned about a unit vector by angles."""
    return _rotation(axis, angle) @ v


def _across(n: np.ndarray, v: np.ndarray) -> np.ndarray:
    return v - (v @ n) * n


def _angle(axis: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(...) rad by which vectors (..., 3) turn about a unit vector; what lies along it does not matter."""
    along = (before @ axis) * (after @ axis)
    return np.arctan2(np.cross(before, after) @ axis, np.sum(before * after, axis=-1) - along)
