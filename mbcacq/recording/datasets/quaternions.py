"""Unit quaternions (w, x, y, z), as instruments report orientations, and rotation matrices."""

from __future__ import annotations

import numpy as np


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
    """Rotation matrices (..., 3, 3) -> unit quaternions (..., 4) with w >= 0."""
    from scipy.spatial.transform import Rotation

    flat = np.asarray(R, dtype=float).reshape(-1, 3, 3)
    q = Rotation.from_matrix(flat).as_quat(canonical=True)
    return q[:, [3, 0, 1, 2]].reshape(*R.shape[:-2], 4)
