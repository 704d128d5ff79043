"""Bytes of one data message to named values and array views. Nothing is copied; views live as long as the buffer does.

A message that contradicts itself raises ProtocolError; a type not known here becomes ``Unknown`` and is skipped by the
caller. No size is believed before the bytes for it are there, so a hostile message cannot make this allocate.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import prod

import numpy as np

from mbcacq.devices import ProtocolError
from mbcacq_gocator import layouts

TICKS_PER_US = 1.024  # stamp value = microseconds * 1.024


@dataclass(frozen=True)
class Stamp:
    """When and where in the encoder's travel a frame was exposed. ``timestamp`` and the encoders are raw ticks.

    every: (k, 5) int64 view, frame, timestamp, encoder, encoder_at_z and status of each where one message has several; the first is the
    stamp itself.
    """

    frame: int
    timestamp: int
    encoder: int
    encoder_at_z: int
    status: int
    serial: int
    ptp_us: int | None
    every: np.ndarray | None = field(default=None, compare=False, repr=False)

    @property
    def time_s(self) -> float:
        return self.timestamp / (TICKS_PER_US * 1e6)


@dataclass(frozen=True)
class ArrayMessage:
    """Surface, profile, video...: attributes by name (only those the firmware sent) and the array as a view."""

    type: int
    attributes: Mapping[str, int]
    array: np.ndarray


@dataclass(frozen=True)
class Measurement:
    """value: (n,) mm, deg, mm^2... as the tool computes, NaN where invalid. passed: (n,) bool."""

    id: int
    value: np.ndarray
    passed: np.ndarray


@dataclass(frozen=True)
class Health:
    """items: structured array (n,) with id, instance, value."""

    items: np.ndarray


@dataclass(frozen=True)
class Unknown:
    """A message of a type this driver does not read."""

    type: int


Message = Stamp | ArrayMessage | Measurement | Health | Unknown


def decode(message: np.ndarray | bytes | bytearray | memoryview) -> tuple[Message, bool]:
    """One whole message, header included, and whether it is the last of its data set. Raises ProtocolError."""
    view = message.data if isinstance(message, np.ndarray) else memoryview(message)
    if view.nbytes < layouts.HEADER.size:
        raise ProtocolError(f"a Gocator message of {view.nbytes} bytes is shorter than its header")
    size, control = layouts.HEADER.unpack_from(view)
    if size != view.nbytes:
        raise ProtocolError(f"a Gocator message says it has {size} bytes but {view.nbytes} arrived")
    kind, last = control & ~layouts.LAST, bool(control & layouts.LAST)
    try:
        return _decode_body(kind, view), last
    except struct.error as error:
        raise ProtocolError(f"{_name(kind)} of {size} bytes is shorter than its fixed part ({error})") from None


def _decode_body(kind: int, view: memoryview) -> Message:
    if kind in layouts.ARRAYS:
        return _array(kind, view)
    if kind == layouts.STAMP:
        return _stamp(view)
    if kind == layouts.MEASUREMENT:
        count, _, identifier = struct.unpack_from("<IHH", view, 6)
        return _measurement(identifier, view, 14, count)
    if kind == layouts.MEASUREMENT_2:
        attribute_size, count, _, identifier = struct.unpack_from("<HIHH", view, 6)
        if attribute_size < 8:
            raise ProtocolError(f"{_name(kind)} has only {attribute_size} bytes of attributes, at least 8 are needed")
        return _measurement(identifier, view, layouts.ATTRIBUTES_AT + attribute_size, count)
    if kind == layouts.HEALTH:
        (count,) = struct.unpack_from("<I", view, 6)
        return Health(_items(kind, view, 14, count, layouts.HEALTH_ITEM))
    return Unknown(kind)


def _array(kind: int, view: memoryview) -> ArrayMessage:
    layout = layouts.ARRAYS[kind]
    (attribute_size,) = struct.unpack_from("<H", view, 6)
    at = layouts.ATTRIBUTES_AT + attribute_size
    if at > view.nbytes:
        raise ProtocolError(f"{_name(kind)} of {view.nbytes} bytes claims {attribute_size} bytes of attributes")
    fields, names = layouts.known_fields(layout, attribute_size)
    attributes = dict(zip(names, fields.unpack_from(view, layouts.ATTRIBUTES_AT), strict=True))
    try:
        shape = tuple(attributes[name] for name in layout.shape) + layout.tail
    except KeyError as missing:
        raise ProtocolError(f"{_name(kind)} has only {attribute_size} bytes of attributes and does not say its {missing}") from None
    return ArrayMessage(kind, attributes, _items(kind, view, at, prod(shape), layout.dtype).reshape(shape))


def _items(kind: int, view: memoryview, at: int, count: int, dtype: np.dtype) -> np.ndarray:
    needed, there = count * dtype.itemsize, view.nbytes - at
    if needed > there:
        raise ProtocolError(f"{_name(kind)} announces an array of {needed} bytes but carries {max(there, 0)}")
    return np.frombuffer(view, dtype, count, at) if count else np.empty(0, dtype)


def _stamp(view: memoryview) -> Stamp:
    count, size, _, _ = layouts.STAMP_HEAD.unpack_from(view, 6)
    start = 6 + layouts.STAMP_HEAD.size
    if count < 1 or size < layouts.STAMP_BODY.size or start + count * size > view.nbytes:
        raise ProtocolError(f"a stamp message of {view.nbytes} bytes cannot hold {count} stamps of {size} bytes")
    frame, timestamp, encoder, encoder_at_z, status, serial, _, _ = layouts.STAMP_BODY.unpack_from(view, start)
    ptp = None
    if size >= layouts.STAMP_BODY.size + layouts.STAMP_PTP.size:
        (ptp,) = layouts.STAMP_PTP.unpack_from(view, start + layouts.STAMP_BODY.size)
    every = np.ndarray((count, 5), "<i8", view, start, (size, 8))
    return Stamp(frame, timestamp, encoder, encoder_at_z, status, serial, ptp, every=every)


def _measurement(identifier: int, view: memoryview, at: int, count: int) -> Measurement:
    if count > layouts.MAX_VALUES:
        raise ProtocolError(f"a Gocator measurement announces {count} values, more than {layouts.MAX_VALUES}")
    items = _items(layouts.MEASUREMENT, view, at, count, layouts.MEASUREMENT_ITEM)
    value = np.where(items["value"] == layouts.INVALID_MEASUREMENT, np.nan, items["value"] / 1000.0)
    return Measurement(identifier, value, (items["decision"] & 1).astype(bool))


def _name(kind: int) -> str:
    return f"a Gocator {layouts.TYPE_NAMES.get(kind, 'unknown')} message (type {kind})"
