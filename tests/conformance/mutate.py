"""Mutations of valid inputs, for fuzzing: bits, bytes, blocks, numbers in binary and in text, splices. Reproducible from a seed."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Sequence

_BYTES = (0, 1, 2, 10, 32, 34, 38, 39, 44, 60, 62, 91, 123, 127, 128, 255)
_WHOLE = (0, 1, 2, 7, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1)
_TEXTS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e999",
    b"-1e-999",
    b"9" * 30,
    b"-1",
    b"0",
    b"",
    b"1_0",
    b"0x10",
    b"1,5",
    b"+.5",
    b"true",
    b"null",
    b"~",
    b"!!python/object:os.system x",
    b"&a [*a]",
    b"[" * 200,
    b"{" * 200,
    b"<![CDATA[",
    b"<!ENTITY",
    b"\xff\xfe",
    b"\0",
    b"\r\n",
    b"'",
    b'"',
    b"\xc3\xa4",
    "\u2028".encode(),
    "\u0665".encode(),
    b"$$",
    b"<!--",
    b"x" * 300,
)
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def mutate(seed: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """One to eight mutations of ``seed``; ``others`` give blocks to splice in."""
    data = bytearray(seed)
    for _ in range(1 + min(int(rng.expovariate(0.7)), 7)):
        _MUTATIONS[int(rng.random() * len(_MUTATIONS))](data, others, rng)
    return bytes(data)


def _at(data: bytearray, rng: random.Random) -> int:
    return int(rng.random() * len(data)) if data else 0


def _flip(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    if data:
        data[_at(data, rng)] ^= 1 << int(rng.random() * 8)


def _byte(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    if data:
        data[_at(data, rng)] = rng.choice(_BYTES)


def _whole(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    at, kind = _at(data, rng), rng.choice("HIQ")
    code = rng.choice("<>") + kind
    size = struct.calcsize(code)
    if at + size <= len(data):
        struct.pack_into(code, data, at, rng.choice(_WHOLE) & ((1 << 8 * size) - 1))


def _cut(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    del data[_at(data, rng) :]


def _remove(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    at = _at(data, rng)
    del data[at : at + 1 + int(rng.random() * 16)]


def _double(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    at = _at(data, rng)
    data[at:at] = data[at : at + 1 + int(rng.random() * 64)]


def _noise(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    at = _at(data, rng)
    data[at:at] = rng.randbytes(1 + int(rng.random() * 8))


def _text(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    at = _at(data, rng)
    data[at:at] = rng.choice(_TEXTS)


def _number(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    found = _NUMBER.search(data, _at(data, rng))
    if found:
        data[found.start() : found.end()] = rng.choice(_TEXTS)


def _splice(data: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    other = rng.choice(others)
    start, at = int(rng.random() * len(other)), _at(data, rng)
    data[at : at + int(rng.random() * 64)] = other[start : start + int(rng.random() * 128)]


_MUTATIONS = (_flip, _byte, _whole, _cut, _remove, _double, _noise, _text, _number, _number, _splice)
