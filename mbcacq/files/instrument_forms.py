"""Text files of instruments and controllers that are no tables as they stand, as lines of one table with tabs.

TwinCAT Scope exports channels side by side, each with a block of keys above it and, if so set, a column of times of its own.
SpatialAnalyzer exports points without headings, or with headings behind ``//``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mbcacq.files.clock import is_clock

SCOPE_MARK = re.compile(r"(start|end)[- ]?time of export", re.IGNORECASE)
SA_MARK = re.compile(r"\bSpatial\s?Analyzer\b|\bSA\b")
MARK_LINES = 40  # at the begin of a file, in which its form is looked for
TICK_S = 1e-7  # of Windows file times
FILE_TIME = 1e16  # numbers above are file times, below milliseconds
_POINT_WORDS = {1: ("point",), 2: ("group", "point"), 3: ("collection", "group", "point")}
_COORDINATES = 3


def as_one_table(lines: Sequence[str]) -> list[str] | None:
    """The same number of lines with headings and rows apart by tabs; None if the file is of no such form."""
    return _of_scope(lines) or _of_points(lines)


def _of_scope(lines: Sequence[str]) -> list[str] | None:
    """An export of TwinCAT Scope: the names of the channels as headings, times in ms of the first channel.

    None if channels have times of their own that differ: such rows belong to different moments.
    """
    if not any(SCOPE_MARK.search(line) for line in lines[:MARK_LINES]):
        return None
    separator = max("\t;,", key=lambda s: sum(line.count(s) for line in lines[:MARK_LINES]))
    cells = [[cell.strip() for cell in line.rstrip("\r\n").split(separator)] for line in lines]
    head = next((i for i, row in enumerate(cells) if row.count("Name") > 1), None)
    if head is None:  # one key for all channels, no times
        head = next((i for i, row in enumerate(cells) if row[0] == "Name" and len([c for c in row if c]) > 2), None)
    first = None if head is None else next((i for i in range(head + 1, len(cells)) if as_number(cells[i][0]) is not None), None)
    if head is None or first is None:
        return None
    names = [(k + 1, name) for k, (key, name) in enumerate(zip(cells[head], cells[head][1:], strict=False)) if key == "Name"]
    out = ["\n"] * len(lines)
    out[head] = "\t".join(["Time [ms]", *(name for _, name in names)]) + "\n"
    begin = as_number(cells[first][0])
    for i in range(first, len(cells)):
        row = cells[i]
        if row[0] in ("", "EOF"):
            continue
        times = {row[k - 1] for k, _ in names if k < len(row)}
        if len(times) > 1:
            return None
        t = as_number(row[0])
        in_ms = row[0] if t is None or begin is None or begin < FILE_TIME else f"{(t - begin) * TICK_S * 1e3:.6g}"
        out[i] = "\t".join([in_ms, *(row[k] if k < len(row) else "" for k, _ in names)]) + "\n"
    return out


def _of_points(lines: Sequence[str]) -> list[str] | None:
    """Points behind ``//`` comments without headings: up to three names, x, y, z, and what follows."""
    comments = [i for i, line in enumerate(lines[:MARK_LINES]) if line.lstrip().startswith("//")]
    if not any(SA_MARK.search(lines[i]) for i in comments):
        return None
    body = [i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("//")]
    rows = [_cells_of(lines[i]) for i in body]
    if not rows or len({len(row) for row in rows}) > 1:
        return None
    named = next((k for k, cell in enumerate(rows[0]) if as_number(cell) is not None and len(rows[0]) - k >= _COORDINATES), None)
    if named not in _POINT_WORDS and named != 0:
        return None
    said = [_cells_of(lines[i].strip().lstrip("/ ")) for i in comments]
    own = next((row for row in said if len(row) == len(rows[0]) and {"x", "y", "z"} <= {cell.lower()[:1] for cell in row}), None)
    headings = own or [*_POINT_WORDS.get(named or 0, ()), "X", "Y", "Z", *_extra(rows[0][(named or 0) + 3 :])]
    out = [line if line.lstrip().startswith("//") else "\n" for line in lines]
    if body[0] < 2:  # the headings take the line before the first row, whose text goes to the line before that
        return None
    if own is None:
        out[body[0] - 2] = out[body[0] - 2].rstrip("\r\n") + " " + out[body[0] - 1]
    out = ["\n" if own and i in comments and said[comments.index(i)] == own else line for i, line in enumerate(out)]
    out[body[0] - 1] = "\t".join(headings) + "\n"
    for i, row in zip(body, rows, strict=True):
        out[i] = "\t".join(row) + "\n"
    return out


def _extra(cells: Sequence[str]) -> list[str]:
    """Headings of what follows x, y, z: the first date or time of day is that of the point."""
    clock = next((k for k, cell in enumerate(cells) if is_clock(cell)), -1)
    return ["Time" if k == clock else f"more_{k + 1}" for k in range(len(cells))]


def _cells_of(line: str) -> list[str]:
    separator = next((s for s in "\t;," if s in line), None)
    return [cell.strip() for cell in (line.strip().split(separator) if separator else line.split())]


def as_number(cell: str) -> float | None:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None
