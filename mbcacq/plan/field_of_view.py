"""Where the scanner must stand for a view, and how far balls lie inside its field of view there."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.plan.schema import FieldOfView, View
from mbcacq.quantities import from_degrees


def aim_depth(field: FieldOfView) -> float:
    """z (mm, scanner frame) of the target of a view. It is 0, or the middle of the view if the frame's origin is not in it, as for a
    scanner whose frame is its camera's."""
    return 0.0 if field.far_z_mm <= 0 <= field.near_z_mm else (field.near_z_mm + field.far_z_mm) / 2


def T_base_scanner(T_base_station: np.ndarray, point: np.ndarray, view: View, depth_mm: float = 0.0) -> np.ndarray:
    """Scanner pose (4, 4) that looks at ``point`` (3,) mm of the station frame.

    The scanner's z axis (towards the scanner) is tilted by tilt from the station's z axis towards azimuth, counted from the station's
    x axis; at tilt 0 and roll 0 both frames are parallel. The point appears at ``view.shift_mm`` in the scanner frame,
    ``depth_mm`` along z added (``aim_depth``).
    """
    tilt, azimuth, roll = from_degrees([view.tilt_deg, view.azimuth_deg, view.roll_deg])
    R = _about_z(azimuth) @ _about_y(tilt) @ _about_z(roll - azimuth)
    return T_base_station @ se3.transform(R, point - R @ (np.array(view.shift_mm) + [0, 0, depth_mm]))


def margin(field: FieldOfView, xyz: np.ndarray, radius: float | np.ndarray = 0.0) -> np.ndarray:
    """Distance (...,) mm by which balls at xyz (..., 3), scanner frame, lie inside the frustum; negative: outside."""
    xyz = np.asarray(xyz, dtype=float)
    depth = field.near_z_mm - field.far_z_mm
    near, far = np.array(field.near_half_mm), np.array(field.far_half_mm)
    slope = (far - near) / depth
    half = near + (field.near_z_mm - xyz[..., 2:]) * slope
    side = (half - np.abs(xyz[..., :2])) / np.sqrt(1 + slope**2)
    inside = np.concatenate([side, field.near_z_mm - xyz[..., 2:], xyz[..., 2:] - field.far_z_mm], axis=-1)
    return inside.min(axis=-1) - radius


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
