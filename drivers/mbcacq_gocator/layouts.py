"""Layout tables of the data messages: which attribute stands where, and what array follows.

A message is ``u32 size | u16 control | body``, little endian; bit 15 of control marks the last message of a data set, the
other bits are the type. Most bodies are ``u16 attribute size | attributes | array``. Firmware grew by appending
attributes, so every table is a sequence read only as far as the message's own attribute size goes, and the array is
taken behind that size, never at a fixed offset.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

HEADER = struct.Struct("<IH")
LAST = 0x8000
ATTRIBUTES_AT = 8  # behind header and the u16 attribute size
INVALID = -32768  # a height or coordinate without a measurement; -1 is a valid one
INVALID_MEASUREMENT = -2147483648
MAX_VALUES = 10_000  # measurements of one data set; a job sends some dozens
MAX_SMALL = 2**20  # bytes of a message that carries no array

HEALTH, STAMP, VIDEO = 0, 1, 2
RANGE, RANGE_INTENSITY = 3, 4
PROFILE_POINTS, UNIFORM_PROFILE, PROFILE_INTENSITY = 5, 6, 7
UNIFORM_SURFACE, SURFACE_INTENSITY = 8, 9
MEASUREMENT, ALIGNMENT_RESULT, EXPOSURE_RESULT = 10, 11, 12
SECTION, EVENT, SURFACE_POINTS, GENERIC, NULL, MEASUREMENT_2 = 20, 22, 28, 29, 30, 31

MAX_MESSAGE = 256 * 2**20
_WITHOUT_ARRAY = frozenset({HEALTH, STAMP, MEASUREMENT, ALIGNMENT_RESULT, EXPOSURE_RESULT, EVENT, NULL, MEASUREMENT_2})

TYPE_NAMES = {
    HEALTH: "health",
    STAMP: "stamp",
    VIDEO: "video",
    RANGE: "range",
    RANGE_INTENSITY: "range intensity",
    PROFILE_POINTS: "profile point cloud",
    UNIFORM_PROFILE: "uniform profile",
    PROFILE_INTENSITY: "profile intensity",
    UNIFORM_SURFACE: "uniform surface",
    SURFACE_INTENSITY: "surface intensity",
    MEASUREMENT: "measurement",
    ALIGNMENT_RESULT: "alignment result",
    EXPOSURE_RESULT: "exposure result",
    16: "edge match",
    17: "box match",
    18: "ellipse match",
    SECTION: "section",
    21: "section intensity",
    EVENT: "event",
    23: "tracheid",
    24: "point feature",
    25: "line feature",
    26: "plane feature",
    27: "circle feature",
    SURFACE_POINTS: "surface point cloud",
    GENERIC: "generic",
    NULL: "null",
    MEASUREMENT_2: "measurement",
    36: "mesh",
}


@dataclass(frozen=True)
class ArrayLayout:
    """fields: (name, struct code) in wire order. shape: names of the attributes that span the array; tail: inner dimension."""

    fields: tuple[tuple[str, str], ...]
    shape: tuple[str, ...]
    dtype: np.dtype
    tail: tuple[int, ...] = ()


def _fields(text: str) -> tuple[tuple[str, str], ...]:
    pairs = (item.split(":") for item in text.split())
    return tuple((first, second) for first, second in pairs)


_STEPS = " stream_step:i stream_step_id:i arrayed_count:i arrayed_index:i"
_SURFACE = "length:I width:I x_resolution:I y_resolution:I z_resolution:I x_offset:i y_offset:i z_offset:i source:B exposure:I "
_PROFILE = "count:I width:I x_resolution:I z_resolution:I x_offset:i z_offset:i source:B exposure:I camera:B reserved:2s"
_I16, _U8 = np.dtype("<i2"), np.dtype("u1")

# Resolutions are nm, offsets um; mm = offset / 1e3 + raw * resolution / 1e6.
ARRAYS = {
    SURFACE_POINTS: ArrayLayout(_fields(_SURFACE + "is_adjacent:B" + _STEPS), ("length", "width"), _I16, (3,)),
    UNIFORM_SURFACE: ArrayLayout(_fields(_SURFACE + "rotation:i reserved:3s" + _STEPS), ("length", "width"), _I16),
    SURFACE_INTENSITY: ArrayLayout(
        _fields("length:I width:I x_resolution:I y_resolution:I x_offset:i y_offset:i source:B exposure:I reserved:3s" + _STEPS),
        ("length", "width"),
        _U8,
    ),
    PROFILE_POINTS: ArrayLayout(_fields(_PROFILE + _STEPS), ("count", "width"), _I16, (2,)),
    UNIFORM_PROFILE: ArrayLayout(_fields(_PROFILE + _STEPS), ("count", "width"), _I16),
    PROFILE_INTENSITY: ArrayLayout(
        _fields("count:I width:I x_resolution:I x_offset:i source:B exposure:I camera:B reserved:2s" + _STEPS), ("count", "width"), _U8
    ),
    RANGE: ArrayLayout(_fields("count:I z_resolution:I z_offset:i source:B exposure:I reserved:3s" + _STEPS), ("count",), _I16),
    RANGE_INTENSITY: ArrayLayout(_fields("count:I source:B exposure:I reserved:3s" + _STEPS), ("count",), _U8),
    VIDEO: ArrayLayout(
        _fields(
            "height:I width:I pixel_size:B pixel_format:B cfa:B source:B camera:B exposure_index:B exposure:I flip_x:B flip_y:B "
            "stream_step:i stream_step_id:i transposed:B"
        ),
        ("height", "width", "pixel_size"),
        _U8,
    ),
    SECTION: ArrayLayout(
        _fields(
            "count:I width:I x_resolution:I z_resolution:I x_offset:i z_offset:i source:B id:I exposure:I pose_angle:i pose_x:i pose_y:i"
        ),
        ("count", "width"),
        _I16,
    ),
}

# One stamp grew from 56 to 64 bytes; larger ones are read up to what is known here.
STAMP_HEAD = struct.Struct("<IHBB")
STAMP_BODY = struct.Struct("<QQqqQIIQ")
STAMP_PTP = struct.Struct("<Q")
MEASUREMENT_ITEM = np.dtype([("value", "<i4"), ("decision", "u1"), ("reserved", "u1", 3)])
HEALTH_ITEM = np.dtype([("id", "<u4"), ("instance", "<u4"), ("value", "<i8")])


@lru_cache(maxsize=256)
def known_fields(layout: ArrayLayout, attribute_size: int) -> tuple[struct.Struct, tuple[str, ...]]:
    """The fields that lie wholly inside ``attribute_size`` bytes, as one struct to unpack at ``ATTRIBUTES_AT``."""
    code, names = "<", []
    for name, kind in layout.fields:
        if struct.calcsize(code + kind) > attribute_size:
            break
        code += kind
        names.append(name)
    return struct.Struct(code), tuple(names)


def size_limit(kind: int) -> int:
    """The largest message of a type that may be received, in bytes."""
    return MAX_SMALL if kind in _WITHOUT_ARRAY else MAX_MESSAGE
