"""A data set as the active faults change it: bytes to send, or what to do with the connection."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.publish import CLOSE, MUTE

_GARBAGE = bytes((i * 89 + 211) % 256 for i in range(4096))
_UNKNOWN_TYPE = 0x3FF
_OFFSET_Z = 36  # of the surface message: header 8, size 8, resolutions 12, two offsets of 4
_WHOLE: dict[str, list[object]] = {"no_data": [], "close_data": [CLOSE], "garbage": [_GARBAGE]}  # instead of the data set


def apply_fault(messages: list[bytearray], faults: Faults) -> list[object]:
    """messages: stamp, surface, then the rest, the last one marked. At most one fault is used up."""
    stamp, surface = messages[:2]

    def stamp_only(_: Any) -> list[object]:
        encode.mark_last(stamp)
        return []

    def shifted(_: Any) -> list[object]:
        """One bit of the surface's offset along z is flipped: 512 um."""
        moved = bytearray(surface)
        moved[_OFFSET_Z + 1] ^= 0x02
        return [moved, *messages[2:]]

    unknown = encode.message(_UNKNOWN_TYPE, b"nobody knows this")
    own = {"stamp_only": stamp_only, "shifted_surface": shifted, "unknown_type": lambda _: [unknown, *messages[1:]]}
    return spoiled(messages, 1, faults, own)


def spoiled(
    messages: Sequence[bytes | bytearray], at: int, faults: Faults, own: Mapping[str, Callable[[Any], list[object]]]
) -> list[object]:
    """The messages as the first active fault lets them out. at: number of the surface. own: what one kind of sensor sends from there on,
    by the fault, of its value."""
    for fault, instead in _WHOLE.items():
        if faults.use(fault):
            return instead
    surface = bytes(messages[at])
    half = surface[: len(surface) // 2]
    short = surface[4 : max(len(surface) * 3 // 4, 70)]
    instead_of_surface: dict[str, Callable[[Any], list[object]]] = {
        "close_in_message": lambda _: [half, CLOSE],
        "stall": lambda _: [half, MUTE],
        "short_message": lambda _: [struct.pack("<I", 4 + len(short)) + short, *messages[at + 1 :]],
        **own,
    }
    for fault, sent in instead_of_surface.items():
        if (value := faults.use(fault)) is not None:
            return [*messages[:at], *sent(value)]
    return list(messages)
