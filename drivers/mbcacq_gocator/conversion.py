"""Raw 16-bit surfaces to points in mm: by the compiled loop where there is one, else with numpy, to the same bit.

The result is float32: within 0.3 m of the origin all its roundings together stay below 0.03 um, a fiftieth of the
sensor's own step. Scales and offsets are formed in float64 and rounded once.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq_gocator.build_loop import SOURCE, library_of
from mbcacq_gocator.layouts import INVALID
from mbcacq_gocator.reused import ReusedMemory

Real = np.floating[Any]
_BLOCK = 32768  # pixels: what is made of them fits the second-level cache
# x, y, z of one pixel, raw and in mm: selected as one item, runs of valid pixels are moved whole
_ROW, _POINT = np.dtype("V6"), np.dtype("V12")
_memory = ReusedMemory()


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
    raw, loop = np.ascontiguousarray(raw, "<i2"), compiled()
    by = _with_numpy if loop is None else _Compiled(loop)
    with np.errstate(over="ignore", invalid="ignore"):  # absurd scales make infinite points, which no gate lets pass
        if raw.ndim == 3:
            return by.cloud(raw, scale.astype(np.float32), offset.astype(np.float32), every)
        x, y = ((offset[axis] + np.arange(n) * scale[axis]).astype(np.float32) for axis, n in enumerate(raw.shape[::-1]))
        return by.heights(raw, x, y, np.float32(scale[2]), np.float32(offset[2]))


def picked(grey: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """(N,) uint8: the grey value of each pixel, copied. grey: (L, W) uint8; pixel: ascending. Raises IndexError for one outside."""
    flat, loop = np.ascontiguousarray(grey, np.uint8).reshape(-1), compiled()
    if len(pixel) and not 0 <= pixel[0] <= pixel[-1] < flat.size:
        raise IndexError(f"pixel {pixel[-1]} of an image of {flat.size}")
    if loop is None and len(pixel) < flat.size:
        return flat[pixel]
    found = _memory.empty(flat.size, np.uint8)[: len(pixel)]
    if len(pixel) == flat.size or loop is None:  # the pixels are in order, each once
        np.copyto(found, flat)
        return found
    loop.pick(flat.ctypes.data, pixel.ctypes.data, len(pixel), found.ctypes.data)
    return found


class _Compiled:
    def __init__(self, loop: ctypes.CDLL) -> None:
        self._loop = loop

    def cloud(self, raw: np.ndarray, scale: np.ndarray, offset: np.ndarray, every: bool) -> tuple[np.ndarray, np.ndarray]:
        points, pixel = self._room(raw.shape[0] * raw.shape[1])
        constants = scale.ctypes.data, offset.ctypes.data
        count = self._loop.cloud_points(raw.ctypes.data, len(pixel), every, *constants, points.ctypes.data, pixel.ctypes.data)
        return points[:count], pixel[:count]

    def heights(self, raw: np.ndarray, x: np.ndarray, y: np.ndarray, scale: Real, offset: Real) -> tuple[np.ndarray, np.ndarray]:
        count = self._loop.count_heights(raw.ctypes.data, raw.size)
        points, pixel = (array[:count] for array in self._room(raw.size))
        grid = x.ctypes.data, y.ctypes.data, scale, offset
        self._loop.height_points(raw.ctypes.data, *raw.shape, count, *grid, points.ctypes.data, pixel.ctypes.data)
        return points, pixel

    @staticmethod
    def _room(pixels: int) -> tuple[np.ndarray, np.ndarray]:
        """Points and pixels, room for all: it has one size for one sensor, so that it fits the next scan too."""
        return _memory.empty(3 * pixels, np.float32).reshape(pixels, 3), _memory.empty(pixels, np.int32)


class _WithNumpy:
    """In blocks, so that the passes over one of them read memory once; only the selection of valid points needs an array of its own."""

    def cloud(self, raw: np.ndarray, scale: np.ndarray, offset: np.ndarray, every: bool) -> tuple[np.ndarray, np.ndarray]:
        flat = raw.reshape(-1)
        if all(flat[start : start + 3 * _BLOCK].min() != INVALID for start in range(0, flat.size, 3 * _BLOCK)):
            return self._to_mm(flat, scale, offset), np.arange(flat.size // 3, dtype=np.int32)
        # The copy is there because numpy compares in vectors only what is contiguous.
        valid = (raw != INVALID).all(axis=2).reshape(-1) if every else raw[..., 2].copy().reshape(-1) != INVALID
        return self._to_mm(flat.view(_ROW)[valid].view(raw.dtype), scale, offset), np.flatnonzero(valid).astype(np.int32)

    def _to_mm(self, raw: np.ndarray, scale: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """raw: (3 N,) int16, x y z in turn. Scale and offset are repeated to a block, so that every pass is contiguous."""
        points = np.empty(raw.size, np.float32)
        factor, shift = (np.tile(v, min(_BLOCK, raw.size // 3)) for v in (scale, offset))
        for start in range(0, raw.size, 3 * _BLOCK):
            out = points[start : start + 3 * _BLOCK]
            out[:] = raw[start : start + 3 * _BLOCK]
            np.multiply(out, factor[: out.size], out=out)
            np.add(out, shift[: out.size], out=out)
        return points.reshape(-1, 3)

    def heights(self, raw: np.ndarray, x: np.ndarray, y: np.ndarray, scale: Real, offset: Real) -> tuple[np.ndarray, np.ndarray]:
        """A block of whole rows holds the points of every pixel, x once for all blocks; from there the valid ones are copied as items."""
        length, width = raw.shape
        valid = (raw != INVALID).reshape(-1)
        pixel = np.arange(raw.size, dtype=np.int32) if valid.all() else np.flatnonzero(valid).astype(np.int32)
        rows = min(max(_BLOCK // width, 1), length)
        block, height = np.empty((rows, width, 3), np.float32), np.empty((rows, width), np.float32)
        block[:, :, 0] = x
        points = np.empty((len(pixel), 3), np.float32)
        source, target = block.view(_POINT).reshape(-1), points.view(_POINT).reshape(-1)
        done = 0
        for start in range(0, length, rows):
            z = height[: length - start]
            z[:] = raw[start : start + rows]
            np.multiply(z, scale, out=z)
            np.add(z, offset, out=block[: len(z), :, 2])
            block[: len(z), :, 1] = y[start : start + rows, None]
            chosen = source[: z.size]
            if len(pixel) < raw.size:
                chosen = chosen[valid[start * width : (start + rows) * width]]
            target[done : done + len(chosen)] = chosen
            done += len(chosen)
        return points, pixel


_with_numpy = _WithNumpy()
