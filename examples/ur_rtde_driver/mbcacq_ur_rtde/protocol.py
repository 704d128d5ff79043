"""RTDE on the wire, protocol version 2: packages of a big-endian length (2 bytes, of the whole package), a type (1 byte) and a payload.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

REQUEST_PROTOCOL_VERSION = 86  # 'V'
GET_URCONTROL_VERSION = 118  # 'v'
TEXT_MESSAGE = 77  # 'M'
DATA_PACKAGE = 85  # 'U'
SETUP_OUTPUTS = 79  # 'O'
SETUP_INPUTS = 73  # 'I'
START = 83  # 'S'
PAUSE = 80  # 'P'

HEADER = struct.Struct(">HB")
LONGEST = 4096
TYPES = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "BOOL": "?", "UINT8": "B", "VECTOR3D": "3d"}


class Malformed(Exception):
    """Bytes that are no RTDE package."""


@dataclass(frozen=True)
class Recipe:
    """What a data package carries. number: given by the controller; names and types (keys of TYPES), in order."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @property
    def layout(self) -> struct.Struct:
        return struct.Struct(">B" + "".join(TYPES[t] for t in self.types))

    def pack(self, values: Sequence[Any]) -> bytes:
        """The payload of a data package; vectors are sequences."""
        flat: list[Any] = []
        for value, kind in zip(values, self.types, strict=True):
            flat += list(value) if kind.startswith("VECTOR") else [value]
        return self.layout.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Values by name. Raises Malformed for another recipe or length."""
        if len(payload) != self.layout.size or payload[0] != self.number:
            raise Malformed(f"a data package of {len(payload)} bytes is not of recipe {self.number}")
        flat, out, at = self.layout.unpack(payload)[1:], {}, 0
        for name, kind in zip(self.names, self.types, strict=True):
            width = int(kind[6]) if kind.startswith("VECTOR") else 1
            out[name] = flat[at : at + width] if kind.startswith("VECTOR") else flat[at]
            at += width
        return out


def package(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def setup_outputs(names: Sequence[str], frequency_hz: float) -> bytes:
    return package(SETUP_OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(names).encode())


def setup_inputs(names: Sequence[str]) -> bytes:
    return package(SETUP_INPUTS, ",".join(names).encode())


def recipe(names: Sequence[str], payload: bytes) -> Recipe:
    """The controller's answer to a setup: a number, and the types. Raises Malformed where a variable is unknown or taken."""
    if not payload:
        raise Malformed("an empty answer to a setup")
    types = tuple(payload[1:].decode("ascii", "replace").split(","))
    bad = [f"{name} is {kind}" for name, kind in zip(names, types, strict=False) if kind not in TYPES]
    if bad or len(types) != len(names):
        raise Malformed(", ".join(bad) or f"{len(types)} types for {len(names)} variables")
    return Recipe(payload[0], tuple(names), types)


class Packages:
    """Bytes in, whole packages (type, payload) out."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Raises Malformed for a length that no package has."""
        self._buffer += data
        out = []
        while len(self._buffer) >= HEADER.size:
            length, kind = HEADER.unpack_from(self._buffer)
            if not HEADER.size <= length <= LONGEST:
                raise Malformed(f"a package of {length} bytes")
            if len(self._buffer) < length:
                break
            out.append((kind, bytes(self._buffer[HEADER.size : length])))
            del self._buffer[:length]
        return out
