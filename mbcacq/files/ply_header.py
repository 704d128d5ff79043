"""The header of a PLY file: what it announces, checked against the length of the file before anything is read."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from mbcacq.errors import ConfigError

MAX_HEADER = 64 * 1024
MAX_LINE = 500
_NAMES = "char uchar int8 uint8 short ushort int16 uint16 int uint int32 uint32 float float32 double float64"
_TYPES: dict[str, str] = dict(
    zip(_NAMES.split(), "i1 u1 i1 u1 i2 u2 i2 u2 i4 u4 i4 u4 f4 f4 f8 f8".split(), strict=True)
)  # as numpy calls them
_TYPE = "(" + "|".join(_TYPES) + ")"
_FORMAT = re.compile(r"format (ascii|binary_little_endian|binary_big_endian) 1\.0")
_ELEMENT = re.compile(r"element ([!-~]{1,100}) (\d{1,10})")
_PROPERTY = re.compile(rf"property (?:list {_TYPE} {_TYPE}|{_TYPE}) ([!-~]{{1,100}})")


@dataclass(frozen=True)
class PlyProperty:
    """type: as numpy calls it, of the entries for a list; counted: type of a list's length, '' if it is no list."""

    name: str
    type: str
    counted: str = ""


@dataclass(frozen=True)
class PlyElement:
    name: str
    count: int
    properties: list[PlyProperty]


@dataclass(frozen=True)
class PlyHeader:
    """size: bytes of the header. comments: what its lines 'comment' and 'obj_info' say."""

    elements: list[PlyElement]
    text: bool
    little: bool
    size: int
    comments: tuple[str, ...] = ()


def read_header(path: Path) -> PlyHeader:
    """Raises ConfigError unless the header is one, has vertices with x, y and z, and the file is long enough for what it announces."""
    with path.open("rb") as file:
        head = file.read(MAX_HEADER)
    end = re.search(rb"(?m)^end_header *\r?\n", head)
    if not head.startswith((b"ply\n", b"ply\r\n")) or end is None:
        raise ConfigError(f"{path}: is no PLY file (its header must begin with 'ply' and end with 'end_header'); export the cloud anew")
    contents, comments = _Contents(), []
    for number, line in enumerate(head[: end.start()].split(b"\n")[1:-1], 2):
        words = _checked_words(path, number, line)
        if words.split(" ", 1)[0] in ("comment", "obj_info"):
            comments.append(words.partition(" ")[2])
        elif not contents.take(number, words):
            raise ConfigError(f"{path}:{number}: '{words[:60]}' is nothing a PLY header may say here; export the cloud anew")
    vertices = [e for e in contents.elements if e.name == "vertex" and e.count]
    if len(vertices) != 1 or not {"x", "y", "z"} <= {p.name for p in vertices[0].properties if not p.counted}:
        raise ConfigError(f"{path}: holds no points (vertices with x, y and z); export the cloud anew")
    there = path.stat().st_size - end.end()
    if contents.size > there + 1:
        raise ConfigError(
            f"{path}: is cut off: its header announces at least {contents.size} bytes of data and there are {there}; copy it anew"
        )
    return PlyHeader(contents.elements, contents.text, contents.little, end.end(), tuple(comments))


def _checked_words(path: Path, number: int, line: bytes) -> str:
    """The line with single blanks. Raises ConfigError for one that is no text."""
    words = " ".join(line.decode("ascii", "replace").split())
    if len(line) > MAX_LINE or "\0" in words:
        raise ConfigError(f"{path}:{number}: a header line of {len(line)} bytes; export the cloud anew")
    return words


class _Contents:
    """What a header announces: ``elements``, of at least ``size`` bytes of data."""

    def __init__(self) -> None:
        self.size, self.text, self.little = 0, False, True
        self.elements: list[PlyElement] = []

    def take(self, number: int, words: str) -> bool:
        """False for a line that may not stand there."""
        if number == 2 and (match := _FORMAT.fullmatch(words)):
            self.text, self.little = match[1] == "ascii", match[1] == "binary_little_endian"
        elif number > 2 and (match := _ELEMENT.fullmatch(words)):
            self.elements.append(PlyElement(match[1], int(match[2]), []))
        elif self.elements and (match := _PROPERTY.fullmatch(words)):
            element = self.elements[-1]
            # A number in text takes a digit and a blank; a list at least its length.
            self.size += element.count * (2 if self.text else int(_TYPES[match[1] or match[3]][1]))
            counted = _TYPES[match[1]] if match[1] else ""
            element.properties.append(PlyProperty(match[4], _TYPES[match[2] or match[3]], counted))
        else:
            return False
        return True
