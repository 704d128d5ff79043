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
    lines = head[: end.start()].split(b"\n")[1:-1]
    text, rows, needed, xyz = False, 0, 0, set()
    element = ""
    for number, line in enumerate(lines, 2):
        words = " ".join(line.decode("ascii", "replace").split())
        if len(line) > MAX_LINE or "\0" in words:
            raise ConfigError(f"{path}:{number}: a header line of {len(line)} bytes; export the cloud anew")
        if words in ("comment", "obj_info"):
            raise ConfigError(f"{path}:{number}: an empty '{words}' line, after which the reader loses its place; remove the line")
        if words.split(" ", 1)[0] in ("comment", "obj_info"):
            continue
        if number == 2 and (match := _FORMAT.fullmatch(words)):
            text = match[1] == "ascii"
        elif number > 2 and (match := _ELEMENT.fullmatch(words)):
            element, rows = match[1], int(match[2])
        elif element and (match := _PROPERTY.fullmatch(words)):
            # A number in text takes a digit and a blank; a list at least its length.
            needed += rows * (2 if text else _BYTES[match[1] or match[3]])
            if element == "vertex" and rows and match[3]:
                xyz.add(match[4])
        else:
            raise ConfigError(f"{path}:{number}: '{words[:60]}' is nothing a PLY header may say here; export the cloud anew")
    if not {"x", "y", "z"} <= xyz:
        raise ConfigError(f"{path}: holds no points (vertices with x, y and z); export the cloud anew")
    there = path.stat().st_size - end.end()
    if needed > there + 1:
        raise ConfigError(f"{path}: is cut off: its header announces at least {needed} bytes of data and there are {there}; copy it anew")
