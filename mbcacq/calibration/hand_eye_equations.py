"""Closed forms of the hand-eye equations A X = X B and A X = Z B, from poses of the flange and of the target alone.

They are what hand-eye calibrations are commonly made with: none weighs noise, none gives an uncertainty. Our own code, on arrays of all
motions at once. Transforms are (K, 4, 4); A_k and B_k are motions of the hand and of the eye between the same two poses.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbcacq.errors import CalibrationError
from mbcacq.geometry import se3
from mbcacq.quantities import DEGREE

MOST_MOTIONS = 5000  # every two of a hundred poses
LEAST_TURN = 0.1 * DEGREE  # a motion that turns less says nothing of an axis

Motions = Callable[[np.ndarray, np.ndarray], np.ndarray]


def motions(hand: np.ndarray, eye: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B (K, 4, 4) between every two poses of a group. hand: (P, 4, 4) such as T_base_flange; eye: (P, 4, 4) T_scanner_target; group:
    (P,) the fixed target that was seen. More than ``MOST_MOTIONS`` are thinned evenly."""
    i, j = np.triu_indices(len(hand), 1)
    same = np.flatnonzero(group[i] == group[j])
    if len(same) > MOST_MOTIONS:
        same = same[np.linspace(0, len(same) - 1, MOST_MOTIONS).astype(int)]
    i, j = i[same], j[same]
    return se3.inverse(hand[j]) @ hand[i], eye[j] @ se3.inverse(eye[i])


def translation(A: np.ndarray, B: np.ndarray, R: np.ndarray) -> np.ndarray:
    """(3,) by least squares from (R_A - 1) t = R t_B - t_A, the rotation R of X known."""
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    return np.linalg.lstsq(left, (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel(), rcond=None)[0]


def _with_translation(A: np.ndarray, B: np.ndarray, R: np.ndarray) -> np.ndarray:
    return se3.transform(R, translation(A, B, R))


def tsai_lenz(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (4, 4) after Tsai and Lenz (1989): modified Rodrigues vectors, then the translation."""
    a, b = (_rodrigues(M) for M in (A, B))
    p = np.linalg.lstsq(se3.skew(a + b).reshape(-1, 3), (b - a).ravel(), rcond=None)[0]
    p = 2 * p / np.sqrt(1 + p @ p)
    R = (1 - p @ p / 2) * np.eye(3) + 0.5 * (np.outer(p, p) + np.sqrt(4 - p @ p) * se3.skew(p))
    return _with_translation(A, B, R)


def _rodrigues(T: np.ndarray) -> np.ndarray:
    """(K, 3): 2 sin(angle / 2) along the axis."""
    w = se3.rotation_log(T[:, :3, :3])
    angle = np.linalg.norm(w, axis=1, keepdims=True)
    return np.where(angle > 0, 2 * np.sin(angle / 2) / np.where(angle > 0, angle, 1.0), 1.0) * w


def park_martin(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (4, 4) after Park and Martin (1994): the rotation that turns the logarithms of B onto those of A."""
    a, b = (se3.rotation_log(M[:, :3, :3]) for M in (A, B))
    return _with_translation(A, B, se3.nearest_rotation(a.T @ b))


def horaud_dornaika(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (4, 4) after Horaud and Dornaika (1995): the unit quaternion of X as an eigenvector."""
    a, b = (_quaternions(M[:, :3, :3]) for M in (A, B))
    S = _left(a) - _right(b)
    q = np.linalg.eigh(np.einsum("kij,kil->jl", S, S))[1][:, 0]
    return _with_translation(A, B, _of_quaternion(q))


def daniilidis(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (4, 4) after Daniilidis (1999): rotation and translation together, by dual quaternions."""
    a, b = (_dual_quaternions(M) for M in (A, B))
    d, s = (a[:, half, 1:] - b[:, half, 1:] for half in (0, 1)), (a[:, half, 1:] + b[:, half, 1:] for half in (0, 1))
    (d0, d1), (s0, s1) = tuple(d), tuple(s)
    T = np.zeros((len(A), 6, 8))
    T[:, :3, 0], T[:, :3, 1:4] = d0, se3.skew(s0)
    T[:, 3:, 0], T[:, 3:, 1:4], T[:, 3:, 4], T[:, 3:, 5:] = d1, se3.skew(s1), d0, se3.skew(s0)
    v7, v8 = np.linalg.svd(T.reshape(-1, 8), full_matrices=False)[2][-2:]
    u1, w1, u2, w2 = v7[:4], v7[4:], v8[:4], v8[4:]
    # (s u1 + u2) . (s w1 + w2) = 0, the one of the two roots with the larger norm of the real part.
    roots = np.roots([u1 @ w1, u1 @ w2 + u2 @ w1, u2 @ w2])
    size = [float(s * s * (u1 @ u1) + 2 * s * (u1 @ u2) + u2 @ u2) for s in np.real(roots)]
    if not size or max(size) <= 0:
        raise CalibrationError("the dual quaternion of the hand-eye transform is not determined; turn about two axes by 10° and more")
    s = float(np.real(roots)[int(np.argmax(size))])
    l2 = 1 / np.sqrt(max(size))
    q, dual = l2 * (s * u1 + u2), l2 * (s * w1 + w2)
    R = _of_quaternion(q)
    t = 2 * _right(_conjugate(q)[None])[0] @ dual
    return se3.transform(R, t[1:])


def andreff(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (4, 4) after Andreff, Horaud and Espiau (1999): linear in the entries of X."""
    RA, RB, K = A[:, :3, :3], B[:, :3, :3], len(A)
    M = np.zeros((K, 12, 12))
    M[:, :9, :9] = np.eye(9) - np.einsum("kij,klm->kiljm", RA, RB).reshape(K, 9, 9)
    M[:, 9:, 9:] = np.eye(3) - RA
    x = _solved(A, B, M, slice(0, 9))
    return _with_translation(A, B, se3.nearest_rotation(x[:9].reshape(3, 3)))


def shah(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X and Z (4, 4) of A X = Z B after Shah (2013): both rotations from one singular value decomposition."""
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    K = np.einsum("kij,klm->iljm", RA, RB).reshape(9, 9)  # rows of R_A R_X R_B' as products with the rows of R_X
    U, _, Vt = np.linalg.svd(K)
    X, Z = (se3.nearest_rotation(M * np.sign(np.linalg.det(M))) for M in (Vt[0].reshape(3, 3), U[:, 0].reshape(3, 3)))  # but for a factor
    return _both_translations(A, B, X, Z)


def li(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X and Z (4, 4) of A X = Z B after Li, Wang and Wu (2010): linear in the entries of both."""
    RA, RB, K, unit = A[:, :3, :3], B[:, :3, :3], len(A), np.eye(3)
    M = np.zeros((K, 12, 24))
    M[:, :9, :9] = np.einsum("kij,lm->kiljm", RA, unit).reshape(K, 9, 9)
    M[:, :9, 9:18] = -np.einsum("ij,kml->kiljm", unit, RB).reshape(K, 9, 9)
    M[:, 9:, 18:21], M[:, 9:, 21:] = -RA, unit
    x = _solved(A, B, M, slice(9, 18))
    X, Z = (se3.nearest_rotation(x[part].reshape(3, 3)) for part in (slice(0, 9), slice(9, 18)))
    return _both_translations(A, B, X, Z)


def _solved(A: np.ndarray, B: np.ndarray, M: np.ndarray, turning: slice) -> np.ndarray:
    """Solution of nine rows of rotations and three of translations for each motion, M (K, 12, u). turning: unknowns of the rotation that
    turns t_B. Lengths are shares of the largest, so that both kinds of rows weigh alike."""
    tA, tB, K = A[:, :3, 3], B[:, :3, 3], len(A)
    size = max(float(np.abs(tB).max(initial=0.0)), 1e-9)
    M[:, 9:, turning] = np.einsum("ij,kl->kijl", np.eye(3), tB / size).reshape(K, 3, 9)
    right = np.concatenate([np.zeros((K, 9)), tA / size], axis=1)
    return np.linalg.lstsq(M.reshape(12 * K, -1), right.ravel(), rcond=None)[0]


def _both_translations(A: np.ndarray, B: np.ndarray, RX: np.ndarray, RZ: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X and Z whose translations solve R_A t_X + t_A = R_Z t_B + t_Z by least squares."""
    left = np.concatenate([A[:, :3, :3], np.broadcast_to(-np.eye(3), (len(A), 3, 3))], axis=2).reshape(-1, 6)
    t = np.linalg.lstsq(left, (B[:, :3, 3] @ RZ.T - A[:, :3, 3]).ravel(), rcond=None)[0]
    return se3.transform(RX, t[:3]), se3.transform(RZ, t[3:])


MOTION_METHODS: dict[str, Motions] = {
    "Tsai-Lenz": tsai_lenz,
    "Park-Martin": park_martin,
    "Horaud-Dornaika": horaud_dornaika,
    "Andreff": andreff,
    "Daniilidis": daniilidis,
}
POSE_METHODS: dict[str, Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]] = {"Shah": shah, "Li": li}


def _quaternions(R: np.ndarray) -> np.ndarray:
    """(K, 4) w, x, y, z with w >= 0 of rotations (K, 3, 3)."""
    w = se3.rotation_log(R)
    angle = np.linalg.norm(w, axis=1, keepdims=True)
    share = np.where(angle > 0, np.sin(angle / 2) / np.where(angle > 0, angle, 1.0), 0.5)
    return np.concatenate([np.cos(angle / 2), share * w], axis=1)


def _dual_quaternions(T: np.ndarray) -> np.ndarray:
    """(K, 2, 4): real and dual part."""
    q = _quaternions(T[:, :3, :3])
    t = np.concatenate([np.zeros((len(T), 1)), T[:, :3, 3]], axis=1)
    return np.stack([q, 0.5 * np.einsum("kij,kj->ki", _left(t), q)], axis=1)


def _left(q: np.ndarray) -> np.ndarray:
    """(K, 4, 4) with ``_left(p) @ q`` the product p q of quaternions."""
    return _product_matrix(q, 1.0)


def _right(q: np.ndarray) -> np.ndarray:
    """(K, 4, 4) with ``_right(q) @ p`` the product p q of quaternions."""
    return _product_matrix(q, -1.0)


def _product_matrix(q: np.ndarray, sign: float) -> np.ndarray:
    out = q[:, 0, None, None] * np.eye(4)
    out[:, 0, 1:], out[:, 1:, 0] = -q[:, 1:], q[:, 1:]
    out[:, 1:, 1:] += sign * se3.skew(q[:, 1:])
    return out


def _conjugate(q: np.ndarray) -> np.ndarray:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _of_quaternion(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a quaternion of any length: q p q* as a matrix on p."""
    q = q / np.linalg.norm(q)
    return (_left(q[None]) @ _right(_conjugate(q)[None]))[0, 1:, 1:]
