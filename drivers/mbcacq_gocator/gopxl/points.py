"""GoPxL surfaces as points in mm in a right-handed frame.

GoPxL's own frame is left-handed (G3 manual). One axis is turned round here, and nowhere else: x, as the sensor's users do.
"""

from __future__ import annotations

import numpy as np

from mbcacq_gocator.gopxl.gdp import GdpSurface

INVALID = -32768


def points_of(surface: GdpSurface, right_handed: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """points: (N, 3) float32 mm; pixel: (N,) int32 = row * columns + column of each.

    A pixel with any invalid coordinate has no point. Copies: nothing refers to the message afterwards.
    """
    raw, scale, offset = surface.raw, surface.scale.copy(), surface.offset.copy()
    if right_handed:
        scale[0], offset[0] = -scale[0], -offset[0]
    if raw.ndim == 2:
        return _uniform(raw, scale, offset)
    valid = (raw != INVALID).all(axis=2).reshape(-1)
    pixel = np.flatnonzero(valid).astype(np.int32)
    points = raw.reshape(-1, 3)[valid].astype(np.float32)
    points *= scale.astype(np.float32)
    points += offset.astype(np.float32)
    return points, pixel


def _uniform(raw: np.ndarray, scale: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y come from the grid: offset + column (row) times resolution."""
    pixel = np.flatnonzero(raw.reshape(-1) != INVALID).astype(np.int32)
    row, column = np.divmod(pixel, max(raw.shape[1], 1))
    points = np.empty((len(pixel), 3), np.float32)
    points[:, 0] = offset[0] + scale[0] * column
    points[:, 1] = offset[1] + scale[1] * row
    points[:, 2] = offset[2] + scale[2] * raw.reshape(-1)[pixel]
    return points, pixel
