"""Messages of the GoPxL Data Protocol: a common section, then a body; a set ends with the message that says so."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mbcacq.devices import ProtocolError
from mbcacq_gocator.wire import MessageReader

NULL, STAMP, UNIFORM_PROFILE, PROFILE_POINTS, UNIFORM_SURFACE, SURFACE_POINTS, MEASUREMENT = 10, 11, 12, 13, 14, 15, 19
NO_VALUE = -1.7976931348623157e308
MAX_MESSAGES = 4096  # of one set
_HEAD = struct.Struct("<IHI")
_STAMP = struct.Struct("<HQQqqQQQ")
_SURFACE = struct.Struct("<HIIII3d3dIf")
_PROFILE = struct.Struct("<HII4df")
_LEGACY_BYTES = range(7)  # pixel formats that take one byte a pixel, whatever they are called


class Common(NamedTuple):
    """The common section of a message. body: where its body begins; transformed: whether a transform stands in the section."""

    type: int
    source: str
    set_id: int
    last: bool
    output: int
    body: int
    transformed: bool


class GdpStamp(NamedTuple):
    """timestamp: in a unit that nobody documents; encoder: ticks."""

    frame: int
    timestamp: int
    encoder: int
    system_time_s: float


@dataclass(frozen=True)
class GdpSurface:
    """raw: (L, W, 3) or, uniform, (L, W) int16, -32768 where invalid. scale, offset: (3,) mm. intensity: (L, W) uint8 or None. layout: what
    the points' place in the message and in space is computed from."""

    raw: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    exposure_us: float
    intensity: np.ndarray | None = None
    layout: tuple[object, ...] = ()


@dataclass(frozen=True)
class GdpProfile:
    """raw: (W, 2) x and z or, uniform, (W,) z, int16, -32768 where invalid. scale, offset: mm, of x and z."""

    raw: np.ndarray
    scale: tuple[float, float]
    offset: tuple[float, float]


@dataclass
class GdpSet:
    """What came until the message marked as last. measurements by output id; refused: status by output id of what could not be made."""

    stamp: GdpStamp | None = None
    surface: GdpSurface | None = None
    profile: GdpProfile | None = None
    measurements: dict[int, float] = field(default_factory=dict)
    refused: dict[int, int] = field(default_factory=dict)
    other: set[int] = field(default_factory=set)


def read_set(reader: MessageReader, deadline: float) -> GdpSet:
    """The next whole set. Raises DeviceTimeout, ConnectError, ProtocolError, Aborted."""
    reader.rewind()
    found = GdpSet()
    for _ in range(MAX_MESSAGES):
        message = reader.read(deadline).data
        common = parse_common(message)
        add(found, message, common)
        if common.last:
            return found
    raise ProtocolError(f"a GDP set of more than {MAX_MESSAGES} messages has no end")


def add(found: GdpSet, message: memoryview, common: Common) -> None:
    """Put one message into the set. Raises ProtocolError."""
    try:
        if common.type == STAMP:
            found.stamp = stamp(message, common.body)
        elif common.type in (UNIFORM_SURFACE, SURFACE_POINTS):
            found.surface = surface(message, common)
        elif common.type in (UNIFORM_PROFILE, PROFILE_POINTS):
            found.profile = profile(message, common)
        elif common.type == MEASUREMENT:
            found.measurements[common.output] = measurement(message, common.body)
        elif common.type == NULL:
            found.refused[common.output] = struct.unpack_from("<i", message, common.body + 2)[0]
        else:
            found.other.add(common.type)
    except struct.error:
        raise ProtocolError(f"a GDP message of type {common.type} ends too early ({len(message)} bytes)") from None


def parse_common(message: memoryview) -> Common:
    """Raises ProtocolError."""
    try:
        size, kind, section = _HEAD.unpack_from(message)
        if size != len(message) or not 12 <= section <= size - 6:
            raise ProtocolError(f"a GDP message of type {kind} has a common section of {section} bytes in {size}")
        at = 11
        transformed = bool(message[at])
        at += 1 + (48 if transformed else 0)
        at += 1 + (24 if message[at] else 0)
        at += 8  # arrayed count and index
        source, at = _text(message, at)
        _, at = _text(message, at)
        set_id, last, output = struct.unpack_from("<QBH", message, at)
    except (struct.error, IndexError):
        raise ProtocolError(f"a GDP message of {len(message)} bytes ends within its common section") from None
    if at + 11 > 6 + section:
        raise ProtocolError(f"the common section of a GDP message of type {kind} is shorter than its content")
    return Common(kind, source, set_id, bool(last), output, 6 + section, transformed)


def _text(message: memoryview, at: int) -> tuple[str, int]:
    (count,) = struct.unpack_from("<H", message, at)
    end = at + 2 + count
    if end > len(message):
        raise IndexError
    return bytes(message[at + 2 : end]).decode("utf-8", "replace"), end


def stamp(message: memoryview, at: int) -> GdpStamp:
    size, frame, timestamp, encoder, _, _, seconds, nanoseconds = _STAMP.unpack_from(message, at)
    if size < _STAMP.size:
        raise struct.error
    return GdpStamp(frame, timestamp, encoder, seconds + nanoseconds * 1e-9)


def measurement(message: memoryview, at: int) -> float:
    """The value in the unit of the tool (mm, deg); NaN if it could not be measured."""
    value, decision = struct.unpack_from("<dB", message, at)
    return float("nan") if value == NO_VALUE or decision >> 1 else value


def surface(message: memoryview, common: Common) -> GdpSurface:
    """The arrays are views into the message. Raises ProtocolError if they do not fit into it."""
    at, points = common.body, common.type == SURFACE_POINTS
    size, rows, columns, grey_rows, grey_columns, *rest = _SURFACE.unpack_from(message, at)
    scale, offset, exposure_ns = np.array(rest[:3]), np.array(rest[3:6]), rest[7]
    short = _SURFACE.size + points  # without a pixel format, which came with release 1.5
    if size < short:
        raise struct.error
    pixel_format = struct.unpack_from("<i", message, at + short)[0] if size >= short + 4 else 1
    count, start = rows * columns * (3 if points else 1), at + size
    if start + 2 * count > len(message):
        raise ProtocolError(f"a GDP surface of {rows} x {columns} points does not fit into its {len(message)} bytes")
    if not (np.isfinite(scale).all() and np.isfinite(offset).all()):
        raise ProtocolError("a GDP surface has a resolution or an offset that is no number")
    raw = np.frombuffer(message, "<i2", count, start).reshape((rows, columns, 3) if points else (rows, columns))
    grey = _intensity(message, start + 2 * count, grey_rows, grey_columns, pixel_format)
    if grey is not None and grey.shape != (rows, columns):
        raise ProtocolError(f"the intensity image is {grey.shape} but the surface {(rows, columns)}")
    layout = (rows, columns, grey_rows, grey_columns, *rest[:6], size, pixel_format, at, common.transformed)
    return GdpSurface(raw, scale, offset, exposure_ns * 1e-3, grey, layout)


def profile(message: memoryview, common: Common) -> GdpProfile:
    """The array is a view into the message; grey values are not read. Raises ProtocolError if it does not fit into it."""
    size, width, _, x_step, z_step, x_offset, z_offset, _ = _PROFILE.unpack_from(message, common.body)
    if size < _PROFILE.size:
        raise struct.error
    points = common.type == PROFILE_POINTS
    count, start = width * (2 if points else 1), common.body + size
    if start + 2 * count > len(message):
        raise ProtocolError(f"a GDP profile of {width} points does not fit into its {len(message)} bytes")
    if not np.isfinite((x_step, z_step, x_offset, z_offset)).all():
        raise ProtocolError("a GDP profile has a resolution or an offset that is no number")
    raw = np.frombuffer(message, "<i2", count, start)
    return GdpProfile(raw.reshape(width, 2) if points else raw, (x_step, z_step), (x_offset, z_offset))


def _intensity(message: memoryview, start: int, rows: int, columns: int, pixel_format: int) -> np.ndarray | None:
    """(L, W) uint8, scaled down where a pixel has two bytes; None if there is none, or in colours."""
    if not rows * columns:
        return None
    bits = 8 if pixel_format in _LEGACY_BYTES else pixel_format >> 16 & 0xFF
    width = -(-columns * bits // 8)
    if start + rows * width > len(message):
        raise ProtocolError(f"a GDP intensity image of {rows} x {columns} pixels does not fit into its message")
    if bits == 8:
        return np.frombuffer(message, np.uint8, rows * width, start).reshape(rows, width)
    if bits == 16:
        return (np.frombuffer(message, "<u2", rows * columns, start).reshape(rows, columns) >> 8).astype(np.uint8)
    return None
