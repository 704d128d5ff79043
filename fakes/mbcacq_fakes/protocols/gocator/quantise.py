"""Points in mm to the 16-bit raw values of a sensor, and onto the uniform grid of its height maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

INVALID = -32768
FINEST_NM = (3000, 3000, 2000)  # as over the measuring volume of a 3210: 154 mm and 110 mm in 16 bits
_BLOCK = 3 * 8192
_ROW, _POINT = np.dtype("V6"), np.dtype("V12")  # one point, raw and in mm
Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Scaling:
    """mm = offset_um / 1e3 + raw * resolution_nm / 1e6, per axis."""

    resolution_nm: Triple
    offset_um: Triple

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray) -> Scaling:
        """The finest steps that reach from low to high (3,) mm; NaN stands for no point at all."""
        low, high = np.nan_to_num(low), np.nan_to_num(high)
        offset = np.rint((low + high) / 2 * 1e3)
        reach = np.maximum(high - offset / 1e3, offset / 1e3 - low)
        steps = np.maximum(np.ceil(reach * 1e6 / 32766), FINEST_NM)
        return cls(_triple(steps), _triple(offset))

    @property
    def scale(self) -> np.ndarray:
        return np.array(self.resolution_nm) / 1e6

    @property
    def offset(self) -> np.ndarray:
        return np.array(self.offset_um) / 1e3


def _triple(values: np.ndarray) -> Triple:
    x, y, z = (int(v) for v in values)
    return x, y, z


def extent(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest coordinate (3,) each, NaN ignored."""
    flat = xyz.reshape(-1)
    whole = flat.size // _BLOCK * _BLOCK
    ends = []
    for reduce in (np.fmin.reduce, np.fmax.reduce):
        parts = [flat[whole:].reshape(-1, 3)] if whole < flat.size else []
        if whole:
            parts.append(reduce(flat[:whole].reshape(-1, _BLOCK), axis=0).reshape(-1, 3))
        ends.append(reduce(np.concatenate(parts), axis=0).astype(float) if parts else np.full(3, np.nan))
    return ends[0], ends[1]


def quantise(xyz: np.ndarray, scaling: Scaling, out: np.ndarray) -> None:
    """xyz (..., 3) mm into out (same shape) int16. A point with NaN, or out of range, becomes invalid in all coordinates."""
    source, target = np.ascontiguousarray(xyz, np.float32).reshape(-1), out.reshape(-1)
    shift = np.tile(scaling.offset.astype(np.float32), _BLOCK // 3)
    factor = np.tile((1 / scaling.scale).astype(np.float32), _BLOCK // 3)
    for start in range(0, source.size, _BLOCK):
        piece, raw = source[start : start + _BLOCK], target[start : start + _BLOCK]
        measured = np.flatnonzero(np.isfinite(piece[2::3]))
        if 2 * len(measured) > piece.size // 3:
            _quantise_block(piece, shift, factor, raw)
            continue
        raw[:] = INVALID
        if len(measured):
            few = np.empty(3 * len(measured), np.int16)
            _quantise_block(piece.view(_POINT)[measured].view(np.float32), shift, factor, few)
            raw.view(_ROW)[measured] = few.view(_ROW)


def _quantise_block(piece: np.ndarray, shift: np.ndarray, factor: np.ndarray, raw: np.ndarray) -> None:
    """At most _BLOCK coordinates x y z in turn."""
    with np.errstate(invalid="ignore"):  # casting NaN; those points are overwritten
        value = piece - shift[: piece.size]
        value *= factor[: piece.size]
        np.rint(value, out=value)
        raw[:] = value
        good = np.abs(value, out=value) <= 32767  # false for NaN
    if not good.all():
        raw.view(_ROW)[~(good[0::3] & good[1::3] & good[2::3])] = np.full(3, INVALID, np.int16).view(_ROW)


def uniform_grid(xyz: np.ndarray, intensity: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None, Scaling]:
    """Height map of an organised cloud (L, W, 3): raw z (L, W) int16 on a grid as fine as the cloud, its intensity, scaling.

    Each cell takes the point that falls into it, moved to the cell's centre along the local slope.
    """
    low, high = extent(xyz)
    scaling = Scaling.over(low, high)
    length, width = xyz.shape[:2]
    span = np.nan_to_num(high - low)
    step = np.maximum(np.ceil(span[:2] * 1e6 / np.maximum([width - 1, length - 1], 1)), 1000).astype(int)
    corner = np.floor(np.nan_to_num(low[:2]) * 1e3).astype(int)
    grid = Scaling((int(step[0]), int(step[1]), scaling.resolution_nm[2]), (int(corner[0]), int(corner[1]), scaling.offset_um[2]))

    measured = np.isfinite(xyz).all(axis=2)
    points = xyz[measured].astype(float)
    column = np.clip(np.rint((points[:, 0] - grid.offset[0]) / grid.scale[0]).astype(int), 0, width - 1)
    row = np.clip(np.rint((points[:, 1] - grid.offset[1]) / grid.scale[1]).astype(int), 0, length - 1)
    slope = _slopes(xyz)[measured]
    x_centre, y_centre = grid.offset[0] + column * grid.scale[0], grid.offset[1] + row * grid.scale[1]
    z = points[:, 2] + slope[:, 0] * (x_centre - points[:, 0]) + slope[:, 1] * (y_centre - points[:, 1])

    raw = np.full((length, width), INVALID, np.int16)
    raw[row, column] = np.clip(np.rint((z - grid.offset[2]) / grid.scale[2]), -32767, 32767)
    grey = None
    if intensity is not None:
        grey = np.zeros((length, width), np.uint8)
        grey[row, column] = intensity[measured]
    return raw, grey, grid


def _slopes(xyz: np.ndarray) -> np.ndarray:
    """dz/dx and dz/dy (L, W, 2) from neighbouring pixels, 0 where they are missing or the surface is too steep."""
    if min(xyz.shape[:2]) < 2:
        return np.zeros((*xyz.shape[:2], 2))
    along_rows, along_columns = np.gradient(xyz.astype(float), axis=(0, 1))
    (xv, yv, zv), (xu, yu, zu) = np.moveaxis(along_rows, 2, 0), np.moveaxis(along_columns, 2, 0)
    with np.errstate(all="ignore"):
        area = xu * yv - xv * yu
        slope = np.stack([(zu * yv - zv * yu) / area, (xu * zv - xv * zu) / area], axis=2)
    usable = np.logical_and(np.isfinite(slope), np.abs(slope) < 5).all(axis=2, keepdims=True)
    return np.where(usable, slope, 0.0)
