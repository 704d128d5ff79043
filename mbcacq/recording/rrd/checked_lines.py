"""JSON, one object a line, each with the CRC-32 of its own text: a line that was torn or damaged is known as such."""

from __future__ import annotations

import json
import os
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CRC = "crc32"
_CHECKED = re.compile(rb'(?P<text>\{.*), "crc32": "(?P<crc>[0-9a-f]{8})"\}')
_NAME_DAMAGED = re.compile(rb', "[^"]{5}": "[0-9a-f]{8}"\}\r?$')  # a checksum under another name of as many bytes


@dataclass(frozen=True)
class Lines:
    """entries: the intact lines as objects, without their checksums. damaged: numbers of the other lines, counted from 1."""

    entries: list[dict[str, Any]]
    damaged: tuple[int, ...]


def checked_line(entry: dict[str, Any]) -> bytes:
    """The line of an entry, with its checksum as last value. Halves of characters, of undecodable file names, become escapes."""
    text = json.dumps(entry, ensure_ascii=False)[:-1].encode("utf-8", errors="backslashreplace")
    return text + f', "{CRC}": "{zlib.crc32(text):08x}"}}\n'.encode()


def read_lines(path: Path) -> Lines:
    """The lines of a file. Lines without a checksum, of an earlier version, count before the first that has one. Raises OSError."""
    return _lines(path.read_bytes())


def read_last_lines(path: Path, most_bytes: int) -> list[dict[str, Any]]:
    """The intact lines at the end of a file that grows, in at most so many bytes; none without such a file."""
    try:
        with path.open("rb") as file:
            begin = max(0, file.seek(0, os.SEEK_END) - most_bytes)
            file.seek(begin)
            data = file.read(most_bytes)
    except OSError:
        return []
    return _lines(data.partition(b"\n")[2] if begin else data).entries


def _lines(data: bytes) -> Lines:
    entries, damaged, checked = [], [], False
    for number, line in enumerate(data.split(b"\n"), 1):
        entry = _entry(line)
        if entry is None:
            damaged += [number] if line.strip() else []
        elif CRC in entry and _intact(line) or CRC not in entry and not checked and not _NAME_DAMAGED.search(line):
            checked = checked or CRC in entry
            entries.append({key: value for key, value in entry.items() if key != CRC})
        else:
            damaged.append(number)
    return Lines(entries, tuple(damaged))


def _entry(line: bytes) -> dict[str, Any] | None:
    try:
        entry = json.loads(line.decode("utf-8", errors="replace"))
    except (ValueError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None


def _intact(line: bytes) -> bool:
    match = _CHECKED.fullmatch(line.strip(b"\r"))
    return match is not None and f"{zlib.crc32(match['text']):08x}".encode() == match["crc"]
