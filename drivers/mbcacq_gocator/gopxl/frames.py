"""Frames of the control channel: a length, a type and one MessagePack map, little endian; lengths count themselves."""

from __future__ import annotations

import struct
from typing import Any

import msgpack

from mbcacq.devices import ProtocolError

REQUEST = struct.Struct("<IHI")  # total length, type, bytes of MessagePack
REPLY = struct.Struct("<IHiI")  # total length, type, status, bytes of MessagePack
MESSAGE_PACK = 0xB000
MAX_REPLY = 32 * 2**20
NOTIFICATION, STREAM = "notification", "stream"


def request(method: str, path: str, payload: dict[str, Any] | None = None, args: dict[str, Any] | None = None) -> bytes:
    """The bytes of a request; empty maps are sent, never left out."""
    body: bytes = msgpack.Packer().pack({"args": args or {}, "method": method, "path": path, "payload": payload or {}})
    return REQUEST.pack(REQUEST.size + len(body), MESSAGE_PACK, len(body)) + body


def reply_size(header: bytes) -> tuple[int, int, int]:
    """What a reply's header announces: status, bytes of MessagePack, and bytes behind those, which the vendor's client skips. Raises
    ProtocolError."""
    total, kind, status, count = REPLY.unpack(header)
    if kind != MESSAGE_PACK or total < REPLY.size + count or total > MAX_REPLY:
        raise ProtocolError(
            f"a reply of {total} bytes (type {kind:#06x}, {count} bytes of content) is none of GoPxL; "
            "something else answers at this port, or the stream is out of step"
        )
    return status, count, total - REPLY.size - count


def content(body: bytes) -> dict[str, Any]:
    """The map of a reply. Raises ProtocolError."""
    try:
        # Limits follow from the size of the body, which is bounded: no announced count can claim more memory.
        found = msgpack.unpackb(body, raw=False, strict_map_key=False)
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:  # TypeError: a map whose key is a map
        raise ProtocolError(f"a reply of GoPxL cannot be read as MessagePack ({type(error).__name__})") from None
    if not isinstance(found, dict) or not isinstance(found.get("type"), str):
        raise ProtocolError("a reply of GoPxL is no map with a type")
    return found
