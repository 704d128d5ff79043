"""The MD-H rows of an arm that is known by its joint axes as lines in space and by its flange, all at joint positions of zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

# rad: axes that differ by less get the row with d of zero that Hayati gives to parallel ones. It is exact at any angle; between the
# nearly parallel axes of a calibrated arm the common normal lies kilometres away.
PARALLEL = 0.05
INTERSECTING_MM = 1e-6  # mm: axes that pass closer meet
NEAR_ZERO = 1e-12


@dataclass(frozen=True)
class ChainInFrames:
    """A chain, and where its own base and flange lie in the frames it was made from.

    MD-H rows have their base's z along axis 1 and their flange's origin on the last axis. T_given_base (4, 4) is the chain's base in the
    given base frame, and T_flange_given (4, 4) the given flange in the chain's. Both are the identity for most arms.
    """

    chain: Chain
    T_given_base: np.ndarray
    T_flange_given: np.ndarray

    def flange(self, q: np.ndarray) -> np.ndarray:
        """The given flange (P, 4, 4) in the given base, q (P, n) rad."""
        return self.T_given_base @ self.chain.flange(q) @ self.T_flange_given


def chain_from_axes(direction: np.ndarray, point: np.ndarray, T_base_flange: np.ndarray, sliding: Sequence[int] = ()) -> ChainInFrames:
    """The rows that repeat an arm's forward kinematics; all signs are +1, so its joint positions stay what they are.

    direction, point: (n, 3), unit vectors about which positive angles turn, or along which prismatic joints slide, and a point (mm) of each
    axis, base frame, at q = 0; T_base_flange: (4, 4) there. sliding: indices of the prismatic joints, of which any point will do. The base
    of an arm that begins with one is the given base.
    """
    T_given_base = _base(direction[0], np.zeros(3) if 0 in sliding else point[0])
    back = se3.inverse(T_given_base)
    rows, frame = _rows_to(direction @ T_given_base[:3, :3], se3.apply(back, point), sliding)
    last = se3.inverse(frame) @ back @ T_base_flange
    rows.append(_last_row(last))
    T_flange_given = se3.inverse(_transform(rows[-1])) @ last
    chain = Chain(np.ones(len(rows)), *np.array(rows).T, sliding=tuple(sliding))
    if 0 in sliding:
        chain, T_given_base = replace(chain, root=T_given_base), np.eye(4)
    return ChainInFrames(chain, _tidy(T_given_base), _tidy(T_flange_given))


def carried(arm: Chain, direction: np.ndarray, point: np.ndarray, sliding: Sequence[int], floor: int) -> Chain:
    """The chain of an arm and of external axes before it: those that carry the artefact, from its table to the floor, then those that carry
    the arm, from the floor on.

    direction, point: (k, 3) lines of the external axes in the arm's base while all of them are at zero, in which direction what is behind
    them moves as seen from what is before; sliding: indices of the prismatic ones; floor: how many carry the artefact. The base of the
    chain is the arm's at zero of these axes: it stays with the table, or on the floor without one.
    """
    own = np.eye(4) if arm.root is None else arm.root
    root = _base(direction[0], np.zeros(3) if 0 in sliding else point[0])
    lines = np.vstack([direction, own[:3, 2]]) @ root[:3, :3], se3.apply(se3.inverse(root), np.vstack([point, own[:3, 3]]))
    rows, frame = _rows_to(*lines, sliding)
    left = se3.inverse(root @ frame) @ own  # about and along the arm's first axis
    of_arm = arm.rows.copy()
    of_arm[0, :2] += np.arctan2(left[1, 0], left[0, 0]), left[2, 3]
    k = len(rows)
    return replace(
        arm.with_rows(np.vstack([rows, of_arm])),
        sign=np.concatenate([np.ones(k), arm.sign]),
        sliding=(*sliding, *(k + i for i in arm.sliding)),
        floor=floor,
        root=root,
        follows=tuple((k + joint, k + leader, ratio) for joint, leader, ratio in arm.follows),
    )


def _rows_to(direction: np.ndarray, point: np.ndarray, sliding: Sequence[int]) -> tuple[list[tuple[float, ...]], np.ndarray]:
    """The rows that lead from the first line to the last (n, 3), the frame of the first being the unit frame, and the frame of the last."""
    frame, rows = np.eye(4), list[tuple[float, ...]]()
    for i, (z, p) in enumerate(zip(direction[1:], point[1:], strict=True), start=1):
        p = frame[:3, 3] if i in sliding else p  # the shortest row
        rows.append(_row(se3.inverse(frame)[:3, :3] @ z, se3.apply(se3.inverse(frame), p)))
        frame = frame @ _transform(rows[-1])
    return rows, frame


def _base(z: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The frame on axis 1 that differs least from the given base: at the foot of its origin, its x turned as little as possible."""
    origin = point - (point @ z) * z
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.99 else np.array([0.0, 0.0, -np.sign(z[0])])
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return se3.transform(np.stack([x, np.cross(z, x), z], axis=1), origin)


def _row(z: np.ndarray, p: np.ndarray) -> tuple[float, float, float, float, float]:
    """theta, d, a, alpha, beta from a frame whose z is one axis to one whose z is the next: along ``z`` (3,), through ``p`` (3,)."""
    across = np.hypot(z[0], z[1])
    if across < PARALLEL:
        # The plane z = 0 meets the next axis; where both are one line, the angle is free and taken as zero.
        meet = p - z * (p[2] / z[2])
        a = float(np.hypot(meet[0], meet[1]))
        theta = float(np.arctan2(meet[1], meet[0])) if a > INTERSECTING_MM else 0.0
        return (*_turn(theta, 0.0, a if a > INTERSECTING_MM else 0.0), *_tilts(theta, z))
    normal = np.array([-z[1], z[0], 0.0]) / across  # of both axes; x of the next frame up to its sign
    a = float(p @ normal)
    if abs(a) < INTERSECTING_MM:
        # Either sign of the normal will do where the axes meet: the one that turns x least.
        a, normal = 0.0, normal if normal[0] > NEAR_ZERO or (abs(normal[0]) <= NEAR_ZERO and normal[1] > 0) else -normal
    elif a < 0:
        a, normal = -a, -normal
    theta = float(np.arctan2(normal[1], normal[0]))
    # The foot of the common normal on this axis: what remains of p is along z and the next axis.
    d = float(p[2] - z[2] * (p[0] * z[0] + p[1] * z[1]) / across**2)
    return (*_turn(theta, d, a), *_tilts(theta, z))


def _turn(theta: float, d: float, a: float) -> tuple[float, float, float]:
    """The same row with an angle within a quarter turn and a negative length, as data sheets write it, where that is shorter."""
    if abs(theta) > np.pi / 2 + 1e-9:
        return float(theta - np.sign(theta) * np.pi), d, -a
    return theta, d, a


def _tilts(theta: float, z: np.ndarray) -> tuple[float, float]:
    """alpha, beta (rad) that turn z of the rotated frame along ``z`` (3,)."""
    theta = _turn(theta, 0.0, 0.0)[0]
    c, s = np.cos(theta), np.sin(theta)
    x, y = c * z[0] + s * z[1], c * z[1] - s * z[0]
    # Rx(alpha) Ry(beta) takes z to (sin beta, -sin alpha cos beta, cos alpha cos beta).
    beta = float(np.arcsin(np.clip(x, -1, 1)))
    return float(np.arctan2(-y, z[2])), beta if abs(beta) > NEAR_ZERO else 0.0


def _last_row(T: np.ndarray) -> tuple[float, float, float, float, float]:
    """To the flange's orientation, its origin put on the axis: R = Rz(theta) Rx(alpha) Ry(beta)."""
    R = T[:3, :3]
    alpha = float(np.arcsin(np.clip(R[2, 1], -1, 1)))
    if abs(R[2, 1]) > 1 - NEAR_ZERO:
        theta, beta = float(np.arctan2(R[1, 0], R[0, 0])), 0.0
    else:
        theta, beta = float(np.arctan2(-R[0, 1], R[1, 1])), float(np.arctan2(-R[2, 0], R[2, 2]))
        if abs(abs(beta) - np.pi) < 1e-9:  # a flange that looks back: turned about x, as data sheets write it
            theta, alpha, beta = float(np.arctan2(np.sin(theta + np.pi), np.cos(theta + np.pi))), np.pi - alpha, 0.0
    return theta, float(T[2, 3]) + 0.0, 0.0, alpha, beta


def _transform(row: tuple[float, ...]) -> np.ndarray:
    return Chain(np.ones(1), *(np.array([v]) for v in row)).flange(np.zeros((1, 1)))[0]


def _tidy(T: np.ndarray) -> np.ndarray:
    """The identity where it is meant."""
    return np.eye(4) if np.abs(T - np.eye(4)).max() < 1e-9 else T
