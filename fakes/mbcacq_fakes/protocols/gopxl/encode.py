"""A frame of the world to the GDP messages of one data set."""

from __future__ import annotations

import struct

import numpy as np

from mbcacq_fakes.protocols.gocator.quantise import Scaling, extent, quantise, uniform_grid
from mbcacq_fakes.world.frame import ScannerFrame

STAMP, UNIFORM_PROFILE, PROFILE_POINTS, UNIFORM_SURFACE, SURFACE_POINTS, MEASUREMENT, NULL = 11, 12, 13, 14, 15, 19, 10


def common(source: str, set_id: int, last: bool, output: int, space: int = 1) -> bytes:
    """The common section, without transform and bounding box, not arrayed."""
    name, stamp_name = source.encode(), b"scanner-0"
    body = bytes([space, 0, 0]) + struct.pack("<IIH", 0, 0, len(name)) + name + struct.pack("<H", len(stamp_name)) + stamp_name
    body += struct.pack("<QBH", set_id, last, output)
    return struct.pack("<I", 4 + len(body)) + body


def message(kind: int, section: bytes, body: bytes) -> bytes:
    return struct.pack("<IH", 6 + len(section) + len(body), kind) + section + body


def stamp(index: int, time_s: float) -> bytes:
    """Body of a stamp: seven attributes."""
    whole = int(time_s)
    nanoseconds = round((time_s - whole) * 1e9)
    return struct.pack("<HQQqqQQQ", 58, index, round(time_s * 1.024e9), 0, 0, 0, whole, nanoseconds)


def surface(frame: ScannerFrame, uniform: bool, intensity: bool, exposure_us: float, volume=None) -> bytes:
    """Body of a surface. The world's frame is right-handed, the sensor's is not: its x runs the other way."""
    mirrored = frame.xyz * np.array([-1, 1, 1], np.float32)
    grey = frame.intensity
    if uniform:
        raw, grey, scaling = uniform_grid(mirrored, frame.intensity)
    else:
        low, high = volume if volume is not None else extent(mirrored)
        if volume is not None:
            low, high = np.array([-high[0], *low[1:]]), np.array([-low[0], *high[1:]])
        scaling = Scaling.over(low, high)
        raw = np.empty(frame.xyz.shape, "<i2")
        quantise(mirrored, scaling, raw)
    rows, columns = frame.xyz.shape[0], frame.xyz.shape[1]
    sends_grey = intensity and grey is not None
    size = 78 + (not uniform)
    section = struct.pack("<HIIII", size, rows, columns, rows * sends_grey, columns * sends_grey)
    section += struct.pack("<3d3dIf", *scaling.scale, *scaling.offset, 1, exposure_us * 1e3)
    section += (b"" if uniform else b"\0") + struct.pack("<i", 1)
    return section + np.ascontiguousarray(raw, "<i2").tobytes() + (np.ascontiguousarray(grey).tobytes() if sends_grey else b"")


def profile(frame: ScannerFrame, exposure_us: float) -> bytes:
    """Body of a uniform profile: the middle row of the surface, without grey values."""
    raw, _, scaling = uniform_grid(frame.xyz * np.array([-1, 1, 1], np.float32), frame.intensity)
    return _profile(raw[len(raw) // 2], scaling, exposure_us)


def profile_points(xz: np.ndarray, volume: tuple[np.ndarray, np.ndarray], exposure_us: float) -> bytes:
    """Body of a profile point cloud. xz: (W, 2) mm, NaN where nothing was measured. volume: (low, high) (3,) mm."""
    low, high = volume
    scaling = Scaling.over(np.array([-high[0], *low[1:]]), np.array([-low[0], *high[1:]]))
    raw = np.empty((1, len(xz), 3), "<i2")
    quantise(np.column_stack([-xz[:, 0], 0 * xz[:, 0], xz[:, 1]])[None].astype(np.float32), scaling, raw)
    return _profile(raw[0][:, [0, 2]], scaling, exposure_us)


def _profile(raw: np.ndarray, scaling: Scaling, exposure_us: float) -> bytes:
    (x_step, _, z_step), (x_offset, _, z_offset) = scaling.scale, scaling.offset
    section = struct.pack("<HII4df", 46, len(raw), 0, x_step, z_step, x_offset, z_offset, exposure_us * 1e3)
    return section + np.ascontiguousarray(raw, "<i2").tobytes()


def middle_of_profile(frame: ScannerFrame) -> float:
    """The middle of a box around the points of the middle row, along x in the sensor's frame (mm); NaN without a point."""
    x = -frame.xyz[len(frame.xyz) // 2, :, 0]
    return float(np.nanmin(x) + np.nanmax(x)) / 2 if np.any(np.isfinite(x)) else float("nan")


def measurement(value: float) -> bytes:
    valid = bool(np.isfinite(value))
    return struct.pack("<dB3d", value if valid else -1.7976931348623157e308, 1 if valid else 2, 0, 0, 0)
