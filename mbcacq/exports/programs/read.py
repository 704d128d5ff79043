"""The program in a file, by its language."""

from __future__ import annotations

import codecs
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.exports.programs import fanuc_ls, krl, rapid, urscript
from mbcacq.exports.programs.program import RobotProgram
from mbcacq.files.bounded_read import bytes_of

MAX_BYTES = 16 << 20
MOST_PROGRAMS = 200  # beside a public data list, that may use it
KRL, URSCRIPT, RAPID, LS = (".src", ".dat"), (".script", ".urscript"), (".mod", ".modx", ".prg", ".sys"), (".ls",)
LANGUAGES = (*KRL, *URSCRIPT, *RAPID, *LS)


def read_program(path: Path, n: int) -> tuple[RobotProgram, Callable[[str], bytes]]:
    """The program of a file for an arm of n axes, and how its text is turned into bytes again.

    Raises ConfigError, naming file and line, for one that cannot be read or has no joint target.
    """
    text, encode = _text(path)
    suffix = path.suffix.lower()
    try:
        if suffix in KRL:
            program = krl.read(text, n, _programs(path, text))
        elif suffix in URSCRIPT:
            program = urscript.read(text, n)
        elif suffix in RAPID:
            program = rapid.read(text, n)
        else:
            program = fanuc_ls.read(text, n)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    if not program.points:
        why = (
            ": " + "; ".join(f"{name} (line {line}) {reason}" for name, line, reason in program.left_alone[:3])
            if program.left_alone
            else ""
        )
        raise ConfigError(f"{path}: has no absolute target with all {n} joint angles{why}; give the file that holds such points")
    if endless := next((point for point in program.points if not np.isfinite(point.angles).all()), None):
        raise ConfigError(f"{path}:{endless.line}: {endless.name} has an angle that is no finite number; correct the program")
    return program, encode


def _programs(path: Path, text: str) -> Iterator[str]:
    """Texts of the programs that use a KRL data list: its own, and all in the folder where it is public."""
    if path.suffix.lower() != ".dat":
        return
    try:
        beside = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".src")[:MOST_PROGRAMS]
    except OSError:
        return
    public = any("PUBLIC" in line.upper() for line in text.split("\n") if line.lstrip().upper().startswith(("DEFDAT", "GLOBAL DEFDAT")))
    for program in beside:
        if public or program.stem.lower() == path.stem.lower():
            yield _text(program)[0]


def _text(path: Path) -> tuple[str, Callable[[str], bytes]]:
    data = bytes_of(path, MAX_BYTES, "give a robot program or a CSV file")
    mark, encoding = next(
        (
            (mark, encoding)
            for mark, encoding in ((codecs.BOM_UTF8, "latin-1"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
            if data.startswith(mark)
        ),
        (b"", "latin-1"),
    )
    try:
        text = data[len(mark) :].decode(encoding)
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: begins like UTF-16 but is not; save it as text") from None
    return text, lambda changed: mark + changed.encode(encoding)
