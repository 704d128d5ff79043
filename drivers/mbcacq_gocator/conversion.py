"""Raw 16-bit surfaces to points in mm: by the compiled loop where there is one, else with numpy, to the same bit.

The result is float32: within 0.3 m of the origin all its roundings together stay below 0.03 um, a fiftieth of the
sensor's own step. Scales and offsets are formed in float64 and rounded once.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np

from mbcacq_gocator.build_loop import SOURCE, library_of
from mbcacq_gocator.layouts import INVALID


def load(library: Path) -> ctypes.CDLL | None:
    """The compiled loop, None where it cannot be used."""
    if sys.byteorder != "little":
        return None
    try:
        loop = ctypes.CDLL(str(library))
        size, at, real = ctypes.c_size_t, ctypes.c_void_p, ctypes.c_float
        loop.count_heights.argtypes, loop.count_heights.restype = [at, size], size
        loop.cloud_points.argtypes, loop.cloud_points.restype = [at, size, ctypes.c_int, at, at, at, at], size
        loop.height_points.argtypes, loop.height_points.restype = [at, size, size, size, at, at, real, real, at, at], None
        loop.pick.argtypes, loop.pick.restype = [at, at, size, at], None
    except (OSError, AttributeError):
        return None
    return loop


@cache
def compiled() -> ctypes.CDLL | None:
    """The loop that was compiled when this package was installed, None where none was."""
    try:
        return load(library_of(SOURCE, SOURCE.parent))
    except OSError:
        return None


def valid_points(raw: np.ndarray, scale: np.ndarray, offset: np.ndarray, every: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """points: (N, 3) float32 mm; pixel: (N,) int32 = row * columns + column of each. Both are copies.

    raw: (L, W, 3) int16, or (L, W) heights on a grid. scale, offset: (3,) float64 mm. A pixel is valid where its z is; every: where all
    its coordinates are.
    """
    if not raw.size:  # 0 rows may announce any number of columns; nothing is to be made for them
        return np.empty((0, 3), np.float32), np.empty(0, np.int32)
    raw, loop, factor, shift = np.ascontiguousarray(raw, "<i2"), compiled(), scale.astype(np.float32), offset.astype(np.float32)
    by = _with_numpy if loop is None else partial(_with_loop, loop)
    with np.errstate(over="ignore", invalid="ignore"):  # absurd scales make infinite points, which no gate lets pass
        grid = [(offset[axis] + np.arange(n) * scale[axis]).astype(np.float32) for axis, n in enumerate(raw.shape[::-1])]
        return by(raw, factor, shift, grid if raw.ndim == 2 else [], every)


def _with_numpy(
    raw: np.ndarray, scale: np.ndarray, offset: np.ndarray, grid: Sequence[np.ndarray], every: bool
) -> tuple[np.ndarray, np.ndarray]:
    """grid: x and y of each column and row, of heights alone."""
    if grid:
        valid = raw != INVALID
        points = np.empty((int(valid.sum()), 3), np.float32)
        for axis, values in enumerate((grid[0], grid[1][:, None])):
            points[:, axis] = np.broadcast_to(values, raw.shape)[valid]
        points[:, 2] = raw[valid]
        points[:, 2] *= scale[2]
        points[:, 2] += offset[2]
    else:
        valid = (raw != INVALID).all(axis=2) if every else raw[..., 2] != INVALID
        points = raw[valid].astype(np.float32)
        points *= scale
        points += offset
    return points, np.flatnonzero(valid).astype(np.int32)


def _with_loop(
    loop: ctypes.CDLL, raw: np.ndarray, scale: np.ndarray, offset: np.ndarray, grid: Sequence[np.ndarray], every: bool
) -> tuple[np.ndarray, np.ndarray]:
    pixels = loop.count_heights(raw.ctypes.data, raw.size) if grid else raw.size // 3
    points, pixel = np.empty((pixels, 3), np.float32), np.empty(pixels, np.int32)
    given, made = (array.ctypes.data for array in (scale, offset)), (points.ctypes.data, pixel.ctypes.data)
    if grid:
        places = (values.ctypes.data for values in grid)
        loop.height_points(raw.ctypes.data, *raw.shape, pixels, *places, scale[2], offset[2], *made)
        return points, pixel
    count = loop.cloud_points(raw.ctypes.data, pixels, every, *given, *made)
    return points[:count], pixel[:count]


def picked(grey: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """(N,) uint8: the grey value of each pixel, copied. grey: (L, W) uint8; pixel: ascending. Raises IndexError for one outside."""
    flat, loop = np.ascontiguousarray(grey, np.uint8).reshape(-1), compiled()
    if len(pixel) and not 0 <= pixel[0] <= pixel[-1] < flat.size:
        raise IndexError(f"pixel {pixel[-1]} of an image of {flat.size}")
    if loop is None:
        return flat[pixel]
    found = np.empty(len(pixel), np.uint8)
    loop.pick(flat.ctypes.data, pixel.ctypes.data, len(pixel), found.ctypes.data)
    return found
