"""A data set as the active faults change it: bytes to send, or what to do with the connection."""

from __future__ import annotations

import struct
from collections.abc import Callable

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.publish import CLOSE, MUTE

_GARBAGE = bytes((i * 89 + 211) % 256 for i in range(4096))
_UNKNOWN_TYPE = 0x3FF
_OFFSET_Z = 36  # of the surface message: header 8, size 8, resolutions 12, two offsets of 4


def apply_fault(messages: list[bytearray], faults: Faults) -> list[object]:
    """messages: stamp, surface, then the rest, the last one marked. At most one fault is used up."""
    for fault, spoiled in _SPOILED.items():
        if faults.use(fault):
            return spoiled(messages)
    return list(messages)


def _half_surface(messages: list[bytearray], then: object) -> list[object]:
    stamp, surface = messages[:2]
    return [stamp, memoryview(surface)[: len(surface) // 2], then]


def _short_surface(messages: list[bytearray]) -> list[object]:
    stamp, surface, *rest = messages
    short = bytearray(surface[: max(len(surface) * 3 // 4, 70)])
    struct.pack_into("<I", short, 0, len(short))
    return [stamp, short, *rest]


def _shifted_surface(messages: list[bytearray]) -> list[object]:
    """One bit of the surface's offset along z is flipped: 512 um."""
    shifted = bytearray(messages[1])
    shifted[_OFFSET_Z + 1] ^= 0x02
    return [messages[0], shifted, *messages[2:]]


def _unknown_type(messages: list[bytearray]) -> list[object]:
    return [messages[0], encode.message(_UNKNOWN_TYPE, b"nobody knows this"), *messages[1:]]


_SPOILED: dict[str, Callable[[list[bytearray]], list[object]]] = {
    "no_data": lambda messages: [],
    "close_data": lambda messages: [CLOSE],
    "garbage": lambda messages: [_GARBAGE],
    "stamp_only": lambda messages: [encode.mark_last(messages[0])],
    "close_in_message": lambda messages: _half_surface(messages, CLOSE),
    "stall": lambda messages: _half_surface(messages, MUTE),
    "short_message": _short_surface,
    "shifted_surface": _shifted_surface,
    "unknown_type": _unknown_type,
}
