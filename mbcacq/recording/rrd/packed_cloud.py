"""A kept cloud as few bytes: coordinates on a grid far below any scanner's noise, differences from point to point, deflated.

Three float32, a pixel and an intensity are 17 bytes a point, which the recording's own compression cannot shorten; packed they are about 5.
"""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from mbcacq.devices import Scan

STEP_MM = 2.0**-13  # 0.12 um: rounding to it adds 0.035 um rms, where a good scanner's noise is 5 um
MOST_MM = 2.0**16  # differences of coordinates fit into 31 bits


def packable(scan: Scan) -> bool:
    """Whether every coordinate is finite and within 65 m."""
    return bool(np.all(np.abs(scan.points) < MOST_MM))


def packed(scan: Scan) -> dict[str, np.ndarray]:
    """The points, pixels and intensities as components of bytes, (k,) uint8 each; what the scan lacks is left out."""
    grid = np.rint(scan.points.astype(np.float64) / STEP_MM).astype(np.int32)
    out = {"packed_points": _deflated(grid)}
    if scan.pixel is not None:
        out["packed_pixel"] = _deflated(scan.pixel.astype(np.int32)[:, None])
    if scan.intensity is not None:
        out["packed_intensity"] = np.frombuffer(zlib.compress(np.asarray(scan.intensity, dtype=np.uint8).tobytes()), np.uint8)
    return out


def unpacked(scan: Scan, components: dict[str, np.ndarray]) -> Scan:
    """The scan with what ``packed`` made of it: points within half a step (in float32), all else as it was. Raises ValueError if bytes
    are damaged."""
    try:
        points = (_inflated(components["packed_points"], 3) * STEP_MM).astype(np.float32)
        pixel, intensity = components.get("packed_pixel"), components.get("packed_intensity")
        return replace(
            scan,
            points=points,
            pixel=None if pixel is None else _inflated(pixel, 1)[:, 0],
            intensity=None if intensity is None else np.frombuffer(zlib.decompress(intensity.tobytes()), np.uint8),
        )
    except zlib.error as error:
        raise ValueError(f"the packed cloud is damaged ({error})") from error


def _deflated(values: np.ndarray) -> np.ndarray:
    """(N, c) int32 -> bytes: differences along N, then all lowest bytes, all second ones and so on, which deflate far better."""
    steps = np.diff(values, axis=0, prepend=np.zeros((1, values.shape[1]), np.int32)).astype("<i4")
    folded = (steps << 1) ^ (steps >> 31)  # small of either sign has zeros above
    planes = np.ascontiguousarray(folded.T).view(np.uint8).reshape(-1, 4).T
    return np.frombuffer(zlib.compress(planes.tobytes(), 6), np.uint8)


def _inflated(data: np.ndarray, columns: int) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(data.tobytes()), np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(planes.T).view("<u4").reshape(columns, -1)
    steps = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
    return np.cumsum(steps, axis=1, dtype=np.int32).T
