"""The header of a PLY file, looked at before a library is: the usual reader crashes the program on some broken ones."""

from __future__ import annotations

import re
from pathlib import Path

from mbcacq.errors import ConfigError

MAX_HEADER = 64 * 1024
MAX_LINE = 500
_BYTES = {
    "char": 1,
    "uchar": 1,
    "int8": 1,
    "uint8": 1,
    "short": 2,
    "ushort": 2,
    "int16": 2,
    "uint16": 2,
    "int": 4,
    "uint": 4,
    "int32": 4,
    "uint32": 4,
    "float": 4,
    "float32": 4,
    "double": 8,
    "float64": 8,
}
_TYPE = "(" + "|".join(_BYTES) + ")"
_FORMAT = re.compile(r"format (ascii|binary_little_endian|binary_big_endian) 1\.0")
_ELEMENT = re.compile(r"element ([!-~]{1,100}) (\d{1,10})")
_PROPERTY = re.compile(rf"property (?:list {_TYPE} {_TYPE}|{_TYPE}) ([!-~]{{1,100}})")


def check_header(path: Path) -> None:
    """Raises ConfigError unless the header is one, has vertices with x, y and z, and the file is long enough for what it announces."""
    with path.open("rb") as file:
        head = file.read(MAX_HEADER)
    end = re.search(rb"(?m)^end_header *\r?\n", head)
    if not head.startswith((b"ply\n", b"ply\r\n")) or end is None:
        raise ConfigError(f"{path}: is no PLY file (its header must begin with 'ply' and end with 'end_header'); export the cloud anew")
    contents = _Contents()
    for number, line in enumerate(head[: end.start()].split(b"\n")[1:-1], 2):
        words = _checked_words(path, number, line)
        if words.split(" ", 1)[0] not in ("comment", "obj_info") and not contents.take(number, words):
            raise ConfigError(f"{path}:{number}: '{words[:60]}' is nothing a PLY header may say here; export the cloud anew")
    if not {"x", "y", "z"} <= contents.coordinates:
        raise ConfigError(f"{path}: holds no points (vertices with x, y and z); export the cloud anew")
    there = path.stat().st_size - end.end()
    if contents.size > there + 1:
        raise ConfigError(
            f"{path}: is cut off: its header announces at least {contents.size} bytes of data and there are {there}; copy it anew"
        )


def _checked_words(path: Path, number: int, line: bytes) -> str:
    """The line with single blanks. Raises ConfigError for one that the library's reader does not survive."""
    words = " ".join(line.decode("ascii", "replace").split())
    if len(line) > MAX_LINE or "\0" in words:
        raise ConfigError(f"{path}:{number}: a header line of {len(line)} bytes; export the cloud anew")
    if words in ("comment", "obj_info"):
        raise ConfigError(f"{path}:{number}: an empty '{words}' line, after which the reader loses its place; remove the line")
    return words


class _Contents:
    """What a header announces: at least ``size`` bytes of data, and vertices with these ``coordinates``."""

    def __init__(self) -> None:
        self.size, self.coordinates = 0, set[str]()
        self._text, self._element, self._rows = False, "", 0

    def take(self, number: int, words: str) -> bool:
        """False for a line that may not stand there."""
        if number == 2 and (match := _FORMAT.fullmatch(words)):
            self._text = match[1] == "ascii"
        elif number > 2 and (match := _ELEMENT.fullmatch(words)):
            self._element, self._rows = match[1], int(match[2])
        elif self._element and (match := _PROPERTY.fullmatch(words)):
            # A number in text takes a digit and a blank; a list at least its length.
            self.size += self._rows * (2 if self._text else _BYTES[match[1] or match[3]])
            if self._element == "vertex" and self._rows and match[3]:
                self.coordinates.add(match[4])
        else:
            return False
        return True
