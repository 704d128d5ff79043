"""RTDE packages, protocol version 2: length of the whole package (2 bytes, big-endian), type (1 byte), payload.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

VERSION, CONTROLLER, TEXT, DATA, OUTPUTS, INPUTS, START = b"VvMUOIS"
LAYOUT = {"DOUBLE": "d", "VECTOR6D": "6d", "VECTOR3D": "3d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B", "BOOL": "?"}
LONGEST = 4096


class BadPackage(Exception):
    """Bytes that no controller sends."""


def packed(kind: int, payload: bytes = b"") -> bytes:
    """A package as it goes over the wire."""
    return struct.pack(">HB", 3 + len(payload), kind) + payload


def split(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Whole packages (type, payload) at the head of a buffer, taken off it. Raises BadPackage for a length that none has."""
    while len(buffer) >= 3:
        length, kind = struct.unpack_from(">HB", buffer)
        if not 3 <= length <= LONGEST:
            raise BadPackage(f"a package of {length} bytes")
        if len(buffer) < length:
            return
        payload = bytes(buffer[3:length])
        del buffer[:length]
        yield kind, payload


class RefusedValues(Exception):
    """The controller does not exchange some of the values; the text is a predicate with what to do."""


class DataLayout:
    """Names and types of the values of one data package, as both sides agreed. answer: of the controller to the request of these names."""

    def __init__(self, names: tuple[str, ...], answer: bytes) -> None:
        types = answer[1:].decode("ascii", "replace").split(",")
        refused = [f"{name} is {kind}" for name, kind in zip(names, types, strict=False) if kind not in LAYOUT]
        in_use, unknown = ([n for n, kind in zip(names, types, strict=False) if kind == why] for why in ("IN_USE", "NOT_FOUND"))
        if in_use:
            raise RefusedValues(
                f"lets another client write {', '.join(in_use)} (IN_USE); end that client (a fieldbus, a URCap or another program of RTDE)"
            )
        if unknown:
            raise RefusedValues(f"does not know {', '.join(unknown)} (NOT_FOUND); its software is too old, update PolyScope")
        if not answer or refused or len(types) != len(names):
            raise BadPackage(f"the controller refuses values ({', '.join(refused) or 'another number of types than of names'})")
        self.number, self.names = answer[0], names
        self._struct = struct.Struct(">B" + "".join(LAYOUT[kind] for kind in types))
        self._width = [int(kind[6]) if kind.startswith("VECTOR") else 0 for kind in types]

    def read(self, payload: bytes) -> dict[str, Any]:
        """Values by name; vectors are tuples. Raises BadPackage."""
        if len(payload) != self._struct.size or payload[0] != self.number:
            raise BadPackage(f"a data package of {len(payload)} bytes, not {self._struct.size}")
        flat = iter(self._struct.unpack(payload)[1:])
        return {
            name: tuple(next(flat) for _ in range(width)) if width else next(flat)
            for name, width in zip(self.names, self._width, strict=True)
        }

    def write(self, values: Mapping[str, Any]) -> bytes:
        """A data package of these values."""
        flat: list[Any] = []
        for name, width in zip(self.names, self._width, strict=True):
            flat += list(values[name]) if width else [values[name]]
        return packed(DATA, self._struct.pack(self.number, *flat))
