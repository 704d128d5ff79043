"""GoPxL surfaces and profiles as points in mm in a right-handed frame.

GoPxL's own frame is left-handed (G3 manual). One axis is turned round here, and nowhere else: x, as the sensor's users do.
"""

from __future__ import annotations

import numpy as np

from mbcacq.devices import ProtocolError
from mbcacq_gocator.conversion import valid_points
from mbcacq_gocator.gopxl.gdp import GdpSet, GdpSurface
from mbcacq_gocator.profiles import ProfileBlock


def points_of(surface: GdpSurface, right_handed: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """points: (N, 3) float32 mm; pixel: (N,) int32 = row * columns + column of each.

    A pixel with any invalid coordinate has no point. Copies: nothing refers to the message afterwards.
    """
    scale, offset = surface.scale.copy(), surface.offset.copy()
    if right_handed:
        scale[0], offset[0] = -scale[0], -offset[0]
    return valid_points(surface.raw, scale, offset, every=True)


def profile_block(found: GdpSet, right_handed: bool = True) -> ProfileBlock | None:
    """The profile of a set, copied; None if it has none. The time is the sensor's system time, as the unit of its other stamp is not
    documented. Raises ProtocolError if a profile has no stamp."""
    stamp, profile = found.stamp, found.profile
    if profile is None:
        return None
    if stamp is None:
        raise ProtocolError("the sensor sent a profile without a stamp")
    turn = -1.0 if right_handed else 1.0
    (x_step, z_step), (x_offset, z_offset) = profile.scale, profile.offset
    return ProfileBlock(
        counter=np.array([stamp.frame]),
        time_s=np.array([stamp.system_time_s]),
        encoder=np.array([stamp.encoder]),
        inputs=np.zeros(1, np.int64),
        raw=profile.raw[None].copy(),
        scale=(turn * x_step, z_step),
        offset=(turn * x_offset, z_offset),
    )
