"""Unit quaternions (w, x, y, z), as instruments report orientations, and rotation matrices."""

from __future__ import annotations

import numpy as np

UNIT = 0.01  # by which the length of a quaternion that enters may differ from 1: instruments write few decimals


def to_matrix(q: np.ndarray) -> np.ndarray:
    """(..., 4) of any length but zero -> rotation matrices (..., 3, 3)."""
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def from_matrix(R: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) -> unit quaternions (..., 4) with w >= 0, by the largest component (Shepperd 1978)."""
    flat = np.asarray(R, dtype=float).reshape(-1, 3, 3)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(flat, 0, 2)
    # 4 q q': row k is q times four times its component k
    products = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
        ]
    )
    largest = np.einsum("kkn->kn", products).argmax(axis=0)
    q = products[largest, :, np.arange(len(flat))]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q).reshape(*R.shape[:-2], 4)
