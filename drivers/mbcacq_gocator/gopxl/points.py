"""GoPxL surfaces as points in mm in a right-handed frame.

GoPxL's own frame is left-handed (G3 manual). One axis is turned round here, and nowhere else: x, as the sensor's users do.
"""

from __future__ import annotations

import numpy as np

from mbcacq_gocator.conversion import valid_points
from mbcacq_gocator.gopxl.gdp import GdpSurface


def points_of(surface: GdpSurface, right_handed: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """points: (N, 3) float32 mm; pixel: (N,) int32 = row * columns + column of each.

    A pixel with any invalid coordinate has no point. Copies: nothing refers to the message afterwards.
    """
    scale, offset = surface.scale.copy(), surface.offset.copy()
    if right_handed:
        scale[0], offset[0] = -scale[0], -offset[0]
    return valid_points(surface.raw, scale, offset, every=True)
