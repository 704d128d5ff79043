"""A frame to the messages of one data set, as firmware of a given generation (4, 5 or 6) writes them."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.protocols.gocator.quantise import INVALID, Scaling, extent, quantise, uniform_grid
from mbcacq_fakes.world.frame import ScannerFrame

LAST = 0x8000
HEALTH, STAMP, UNIFORM_SURFACE, INTENSITY, MEASUREMENT, SURFACE_POINTS, MEASUREMENT_2 = 0, 1, 8, 9, 10, 28, 31
PROFILE_POINTS = 5
ALIGNMENT_RESULT = 11
_SURFACE_STEP, _PROFILE_STEP = 3, 2
_INVALID_VALUE = -2147483648
# Bytes that generations before 6 (no arrayed pair) and before 5 (no stream step) leave off at the end of the attributes.
_MISSING = {4: 16, 5: 8, 6: 0}


@dataclass(frozen=True)
class DataSetHeader:
    """What a data set says besides the points. ticks: the stamp. index: exposures before. generation: 4, 5 or 6, of the firmware.

    uniform: as a height map instead of points. intensity: with its grey values. volume: measuring volume (low, high) mm, None for the
    extent of the points.
    """

    exposure_us: float
    ticks: int
    index: int
    serial: int
    encoder: int = 0
    uniform: bool = False
    intensity: bool = True
    generation: int = 6
    volume: tuple[np.ndarray, np.ndarray] | None = None


def data_set(frame: ScannerFrame, header: DataSetHeader) -> list[bytearray]:
    """Stamp, surface, intensity if there is one, measurements; the last one marked."""
    generation = header.generation
    messages = [stamp(header.index, header.ticks, header.encoder, header.serial, generation)]
    exposure_ns = min(int(round(header.exposure_us * 1000)), 2**32 - 1)
    if header.uniform or generation < 5:
        raw, grey, scaling = uniform_grid(frame.xyz, frame.intensity)
        messages.append(uniform_surface(raw, scaling, exposure_ns, generation))
    else:
        scaling, grey = Scaling.over(*(header.volume or extent(frame.xyz))), frame.intensity
        messages.append(surface_points(frame.xyz, scaling, exposure_ns, generation))
    if header.intensity and grey is not None:
        messages.append(surface_intensity(grey, scaling, exposure_ns, generation))
    results = frame.measurements or {0: _mean_height(frame.xyz)}
    messages += [measurement(identifier, value, generation) for identifier, value in results.items()]
    mark_last(messages[-1])
    return messages


def stamp(index: int, ticks: int, encoder: int, serial: int, generation: int = 6, status: int = 0) -> bytearray:
    body = struct.pack("<QQqqQIIQ", index, ticks, encoder, encoder, status, serial, 0, 0)
    if generation >= 6:
        body += struct.pack("<Q", int(ticks / 1.024))
    return message(STAMP, struct.pack("<IHBB", 1, len(body), 0, 0) + body)


def surface_points(xyz: np.ndarray, scaling: Scaling, exposure_ns: int, generation: int = 6) -> bytearray:
    attributes = struct.pack(
        "<II3I3iBIBiiii", *xyz.shape[:2], *scaling.resolution_nm, *scaling.offset_um, 0, exposure_ns, 0, _SURFACE_STEP, 0, 1, 0
    )
    result, array = _with_array(SURFACE_POINTS, attributes, generation, xyz.shape, np.dtype("<i2"))
    quantise(xyz, scaling, array)
    return result


def uniform_surface(raw: np.ndarray, scaling: Scaling, exposure_ns: int, generation: int = 6) -> bytearray:
    attributes = struct.pack(
        "<II3I3iBIi3siiii", *raw.shape, *scaling.resolution_nm, *scaling.offset_um, 0, exposure_ns, 0, bytes(3), _SURFACE_STEP, 0, 1, 0
    )
    result, array = _with_array(UNIFORM_SURFACE, attributes, generation, raw.shape, np.dtype("<i2"))
    array[...] = raw
    return result


def profile_points(xz: np.ndarray, scaling: Scaling, exposure_ns: int, generation: int = 6) -> bytearray:
    """xz: (C, W, 2) mm, NaN where nothing was measured."""
    attributes = _profile_attributes(xz.shape[:2], scaling, exposure_ns)
    result, array = _with_array(PROFILE_POINTS, attributes, generation, xz.shape, np.dtype("<i2"))
    array[...] = _raw(xz, scaling.scale[[0, 2]], scaling.offset[[0, 2]])
    return result


def _profile_attributes(shape: tuple[int, ...], scaling: Scaling, exposure_ns: int) -> bytes:
    x, _, z = range(3)
    resolution, offset = scaling.resolution_nm, scaling.offset_um
    steps = (_PROFILE_STEP, 0, 1, 0)
    return struct.pack("<II2I2iBIB2siiii", *shape, resolution[x], resolution[z], offset[x], offset[z], 0, exposure_ns, 0, bytes(2), *steps)


def _raw(values: np.ndarray, scale: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(.., k) mm as int16; invalid in all coordinates where one has none, or is out of range."""
    steps = np.rint((values - offset) / scale)
    good = (np.abs(steps) <= 32767).all(axis=-1, keepdims=True)
    return np.where(good, steps, INVALID).astype("<i2")


def surface_intensity(grey: np.ndarray, scaling: Scaling, exposure_ns: int, generation: int = 6) -> bytearray:
    attributes = struct.pack(
        "<II2I2iBI3siiii", *grey.shape, *scaling.resolution_nm[:2], *scaling.offset_um[:2], 0, exposure_ns, bytes(3), _SURFACE_STEP, 0, 1, 0
    )
    result, array = _with_array(INTENSITY, attributes, generation, grey.shape, np.dtype("u1"))
    array[...] = grey
    return result


def measurement(identifier: int, value: float, generation: int = 6) -> bytearray:
    """value in mm, deg... (1/1000 on the wire); NaN is sent as invalid, decision 'invalid value'."""
    valid = np.isfinite(value)
    item = struct.pack("<iB3s", int(round(value * 1000)) if valid else _INVALID_VALUE, 1 if valid else 2, bytes(3))
    if generation >= 6:
        return message(MEASUREMENT_2, struct.pack("<HI2sHii", 16, 1, bytes(2), identifier, 1, 0) + item)
    return message(MEASUREMENT, struct.pack("<I2sH", 1, bytes(2), identifier) + item)


def health(values: dict[tuple[int, int], int]) -> bytearray:
    """values by (indicator id, instance)."""
    items = b"".join(struct.pack("<IIq", identifier, instance, value) for (identifier, instance), value in values.items())
    return mark_last(message(HEALTH, struct.pack("<IB3s", len(values), 0, bytes(3)) + items))


def operation_result(kind: int, operation: int) -> bytearray:
    """The later answer to an alignment: success."""
    return mark_last(message(kind, struct.pack("<HIi", 8, operation, 1)))


def message(kind: int, body: bytes) -> bytearray:
    return bytearray(struct.pack("<IH", 6 + len(body), kind) + body)


def mark_last(data: bytearray) -> bytearray:
    data[5] |= LAST >> 8
    return data


def _with_array(kind: int, attributes: bytes, generation: int, shape: tuple[int, ...], dtype: np.dtype) -> tuple[bytearray, np.ndarray]:
    attributes = attributes[: len(attributes) - _MISSING[generation]]
    count = int(np.prod(shape))
    result = bytearray(8 + len(attributes) + count * dtype.itemsize)
    struct.pack_into("<IHH", result, 0, len(result), kind, len(attributes))
    result[8 : 8 + len(attributes)] = attributes
    return result, np.frombuffer(result, dtype, count, 8 + len(attributes)).reshape(shape)


def _mean_height(xyz: np.ndarray) -> float:
    z = xyz[::8, ::8, 2]
    measured = np.isfinite(z)
    return float(z[measured].mean()) if measured.any() else float("nan")
