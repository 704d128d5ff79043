"""Rigid motions as arrays (..., 4, 4), only what the world needs."""

from __future__ import annotations

import numpy as np


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Rotation (..., 3, 3) and translation (..., 3) -> (..., 4, 4)."""
    out = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], np.shape(translation)[:-1]), 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out


def rotation_about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation about a unit axis (..., 3) by an angle (...): (..., 3, 3), as cos I + (1 - cos) k k' + sin [k]."""
    axis = np.asarray(axis, dtype=float)
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    c, s = np.cos(angle), np.sin(angle)
    v = 1.0 - c
    out = np.empty((*np.broadcast_shapes(x.shape, c.shape), 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c + v * x * x, v * x * y - s * z, v * x * z + s * y
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = v * x * y + s * z, c + v * y * y, v * y * z - s * x
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = v * x * z - s * y, v * y * z + s * x, c + v * z * z
    return out


def screw(axis: np.ndarray, point: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation about the line through ``point`` (3,) along unit ``axis`` (3,) by ``angle`` (P,): (P, 4, 4)."""
    rotation = rotation_about(axis, angle)
    return rigid(rotation, point - rotation @ point)


def displacement(translation: np.ndarray, rotation_vector: np.ndarray) -> np.ndarray:
    """A small displacement: turn by a rotation vector (..., 3) rad, then shift by (..., 3) mm: (..., 4, 4)."""
    angle = np.linalg.norm(rotation_vector, axis=-1)
    axis = rotation_vector / np.where(angle > 0, angle, 1.0)[..., None]
    return rigid(rotation_about(axis, angle), translation)


def invert(T: np.ndarray) -> np.ndarray:
    back = np.swapaxes(T[..., :3, :3], -1, -2)
    return rigid(back, -(back @ T[..., :3, 3:])[..., 0])


def carry(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., N, 3) moved by T (..., 4, 4)."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
