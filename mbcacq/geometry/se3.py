"""Rotations and rigid transforms as arrays (..., 3, 3) and (..., 4, 4), and their robust fits to points.

A twist is (..., 6) = (v, w): translation in mm first, rotation in rad second.
"""

from __future__ import annotations

import numpy as np

POINTS_AT_ONCE = 8192  # the transforms gathered for so many stay in a processor's caches
ROUNDS = 6  # of reweighting
ALIKE = 10.0  # times the median distance: without an outlier beyond it, other weights would change little
LEAST_DETERMINED = 1e-7  # eigenvalue of the scaled normal equations below which a direction counts as undetermined


def skew(w: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with ``skew(w) @ p == cross(w, p)``."""
    out = np.zeros((*w.shape, 3), dtype=w.dtype)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of (..., 3) and (..., 3), leading axes broadcast."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), dtype=np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def rotation_exp(w: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: rotation vectors (..., 3) rad -> matrices (..., 3, 3)."""
    angle2 = np.sum(w * w, axis=-1)
    angle = np.sqrt(angle2)
    small = angle2 < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    k = skew(w)
    return np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k)


def rotation_log(rotation: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) -> rotation vectors (..., 3) rad, angle in [0, pi]; exact up to and including half a turn."""
    flat = np.asarray(rotation, dtype=float).reshape(-1, 3, 3)
    axis = 0.5 * np.stack([flat[:, 2, 1] - flat[:, 1, 2], flat[:, 0, 2] - flat[:, 2, 0], flat[:, 1, 0] - flat[:, 0, 1]], axis=1)
    sine, cosine = np.sqrt(np.einsum("ni,ni->n", axis, axis)), 0.5 * (np.einsum("nii->n", flat) - 1.0)
    out = axis * (np.arctan2(sine, cosine) / np.where(sine > 0, sine, 1.0))[:, None]
    out[sine == 0] = 0.0
    obtuse = cosine < -0.9
    if obtuse.any():  # the axis fades from the antisymmetric part; it is in the symmetric one
        from scipy.spatial.transform import Rotation

        out[obtuse] = Rotation.from_matrix(flat[obtuse]).as_rotvec()
    return out.reshape(*rotation.shape[:-2], 3)


def exp(twist: np.ndarray) -> np.ndarray:
    """Exponential of twists (..., 6) = (v, w) -> transforms (..., 4, 4)."""
    v, w = twist[..., :3], twist[..., 3:]
    angle2 = np.sum(w * w, axis=-1)
    small = angle2 < 1e-8
    safe = np.sqrt(np.where(small, 1.0, angle2))
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    c = np.where(small, 1.0 / 6.0 - angle2 / 120.0, (safe - np.sin(safe)) / safe**3)
    k = skew(w)
    left = np.eye(3) + b[..., None, None] * k + c[..., None, None] * (k @ k)
    return transform(rotation_exp(w), np.einsum("...ij,...j->...i", left, v))


def coordinates(T: np.ndarray) -> np.ndarray:
    """Translation, mm, and rotation vector, rad, (..., 6) of transforms (..., 4, 4); of a small one its twist."""
    return np.concatenate([T[..., :3, 3], rotation_log(T[..., :3, :3])], axis=-1)


def transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Rotation (..., 3, 3) and translation (..., 3) mm -> (..., 4, 4)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros((*shape, 4, 4), dtype=np.result_type(rotation, translation))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, translation, 1.0
    return out


def inverse(T: np.ndarray) -> np.ndarray:
    """Inverse of rigid transforms (..., 4, 4)."""
    back = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(back, -np.einsum("...ij,...j->...i", back, T[..., :3, 3]))


def apply(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points (..., 3) by (..., 4, 4); leading axes broadcast."""
    return np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3]


def apply_each(T: np.ndarray, which: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (M, 3), each transformed by that of T (k, 4, 4) whose number which (M,) gives."""
    out = np.empty(points.shape, dtype=np.result_type(T, points))
    for start in range(0, len(points), POINTS_AT_ONCE):
        some = slice(start, start + POINTS_AT_ONCE)
        out[some] = apply(T[which[some]], points[some])
    return out


def adjoint(T: np.ndarray) -> np.ndarray:
    """(..., 6, 6) taking a twist expressed in the inner frame of T to the same twist in the outer frame: T exp(x) = exp(Ad x) T."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6), dtype=T.dtype)
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(t) @ R
    return out


def from_abc(xyz: np.ndarray, abc: np.ndarray) -> np.ndarray:
    """KUKA frame: xyz (..., 3) mm, abc (..., 3) rad -> (..., 4, 4) with R = Rz(A) Ry(B) Rx(C)."""
    a, b, c = np.moveaxis(np.asarray(abc, dtype=float), -1, 0)
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    R = np.stack(
        [
            np.stack([ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc], -1),
            np.stack([sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc], -1),
            np.stack([-sb, cb * sc, cb * cc], -1),
        ],
        -2,
    )
    return transform(R, np.asarray(xyz, dtype=float))


def to_abc(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of ``from_abc``: (xyz mm, abc rad), B in [-pi/2, pi/2]; at B = +-90 deg C is set to 0."""
    R = T[..., :3, :3]
    cb = np.hypot(R[..., 0, 0], R[..., 1, 0])
    b = np.arctan2(-R[..., 2, 0], cb)
    locked = cb < 1e-9
    a = np.where(locked, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    c = np.where(locked, 0.0, np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    return T[..., :3, 3].copy(), np.stack([a, b, c], -1)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation closest to a matrix (..., 3, 3) in the Frobenius norm (SVD, determinant kept +1)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u = u.copy()
    u[..., :, 2] *= sign[..., None]
    return u @ vt


def fit_rigid_transforms(a: np.ndarray, b: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Rigid transforms (count, 4, 4) that bring the points a (M, 3) of each group onto b (Kabsch), reweighted against outliers."""
    R, ca, cb = _kabsch(a, b, np.ones(len(a)), group, count)
    for _ in range(ROUNDS - 1):
        off = np.linalg.norm(b - cb[group] - np.einsum("mij,mj->mi", R[group], a - ca[group]), axis=1)
        if off.max(initial=0.0) < ALIKE * np.median(off):
            break
        R, ca, cb = _kabsch(a, b, 1.0 / np.maximum(off, 0.5 * np.median(off) + 1e-9), group, count)
    return transform(R, cb - np.einsum("sij,sj->si", R, ca))


def _kabsch(a: np.ndarray, b: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted best rotations (count, 3, 3) of a (M, 3) onto b (M, 3) by group (Kabsch 1976), and both weighted means (count, 3)."""
    ca, cb = _means(a, weight, group, count), _means(b, weight, group, count)
    da, db = a - np.take(ca, group, axis=0), b - np.take(cb, group, axis=0)
    product = np.einsum("mi,mj->mij", db, weight[:, None] * da).reshape(-1, 9)
    return nearest_rotation(_sums(product, group, count).reshape(-1, 3, 3)), ca, cb


def least_distances(columns: np.ndarray, target: np.ndarray, group: np.ndarray, sigma: np.ndarray | None = None) -> np.ndarray | None:
    """x that minimises the sum of lengths of ``columns x - target`` (M, 3), each group about a free mean; None if undetermined.

    sigma: prior standard deviation of each unknown about zero, inf for none. An unknown that has one is never undetermined.
    """
    ridge = 0.0 if sigma is None else sigma**-2.0
    count = group.max(initial=0) + 1
    weight = np.ones(len(columns))
    x = None
    for _ in range(ROUNDS):
        A, b = _centred(columns, weight, group, count), _centred(target, weight, group, count)
        flat = (A * weight[:, None, None]).reshape(-1, A.shape[2])
        normal = flat.T @ A.reshape(-1, A.shape[2])
        normal[np.diag_indices_from(normal)] += ridge
        scale = np.sqrt(np.diag(normal))
        if not np.all(scale > 0):
            return None
        scaled = normal / scale[:, None] / scale
        if np.linalg.eigvalsh(scaled)[0] < LEAST_DETERMINED:
            return None
        x = np.linalg.solve(scaled, flat.T @ b.reshape(-1) / scale) / scale
        off = np.linalg.norm(A @ x - b, axis=1)
        weight = 1.0 / np.maximum(off, 0.2 * np.median(off) + 1e-9)
    return x


def _centred(values: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """values (M, ...) less the weighted mean of their group."""
    flat = values.reshape(len(values), -1)
    return (flat - _means(flat, weight, group, count)[group]).reshape(values.shape)


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, k) of values (M, k) by group."""
    k = values.shape[1]
    return np.bincount((group[:, None] * k + np.arange(k)).ravel(), values.ravel(), count * k).reshape(count, k)


def _means(values: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Weighted means (count, k); zero for an empty group."""
    total = np.bincount(group, weight, count)
    return _sums(values * weight[:, None], group, count) / np.where(total > 0, total, 1.0)[:, None]
