"""A data set as the active faults let it out: pieces to send, or what to do with the connection."""

from __future__ import annotations

import struct

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.faults import Faults
from mbcacq_fakes.protocols.gocator.publish import CLOSE, MUTE

_GARBAGE = bytes((i * 89 + 211) % 256 for i in range(4096))
_NOBODY_KNOWS = 0x3FF


def spoil(messages: list[bytearray], faults: Faults) -> list[object]:
    """messages: stamp, surface, then the rest, the last one marked."""
    if faults.use("no_data"):
        return []
    if faults.use("close_data"):
        return [CLOSE]
    if faults.use("garbage"):
        return [_GARBAGE]
    if faults.use("stamp_only"):
        return [encode.mark_last(messages[0])]
    stamp, surface, *rest = messages
    half = memoryview(surface)[: len(surface) // 2]
    if faults.use("close_in_message"):
        return [stamp, half, CLOSE]
    if faults.use("stall"):
        return [stamp, half, MUTE]
    if faults.use("short_message"):
        short = bytearray(surface[: max(len(surface) * 3 // 4, 70)])
        struct.pack_into("<I", short, 0, len(short))
        return [stamp, short, *rest]
    if faults.use("unknown_type"):
        return [stamp, encode.message(_NOBODY_KNOWS, b"nobody knows this"), surface, *rest]
    return [stamp, surface, *rest]
