"""The text of a CSV file (RFC 4180) as rows of cells, in the dialects that spreadsheets write."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import bytes_of
from mbcacq.files.instrument_forms import as_number, as_one_table

SPREADSHEETS = (".xlsx", ".xls", ".ods")
SEPARATORS = (",", ";", "\t")
PREAMBLE_LINES = 100
_HINT = re.compile(r"sep=([,;\t])\s*", re.IGNORECASE)
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+$")


@dataclass(frozen=True)
class Dialect:
    """How a file is written. newline: between rows; bom, hint: whether a byte order mark and a line ``sep=;`` stand in front."""

    separator: str = ","
    encoding: str = "utf-8"
    newline: str = "\n"
    bom: bool = False
    hint: bool = False

    def encoded(self, text: str) -> bytes:
        mark = {"utf-8": codecs.BOM_UTF8, "utf-16-le": codecs.BOM_UTF16_LE, "utf-16-be": codecs.BOM_UTF16_BE}.get(self.encoding, b"")
        return (mark if self.bom else b"") + text.encode(self.encoding, errors="replace")


@dataclass(frozen=True)
class CsvText:
    """Rows of a file. line: of each row in the file; preamble, comments: lines before the headings, and those left out; counted: what
    ``line`` numbers, 'line' in a file of lines."""

    headings: list[str]
    rows: list[list[str]]
    line: list[int]
    heading_line: int
    dialect: Dialect
    preamble: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    counted: str = "line"


def read_csv_text(
    path: Path, *, max_bytes: int, comment: str = "", score: Callable[[Sequence[str]], tuple[int, bool]] | None = None
) -> CsvText:
    """Read a file. comment: mark at the front of lines that are left out. score: how many columns a row of headings gives, and whether
    these are all; where it is given, lines before the headings are allowed.

    Raises ConfigError with file, line and column of the first fault.
    """
    text, dialect = _decoded(path, _bytes(path, max_bytes))
    if "\0" in text:
        line = len(_LINE.findall(text[: text.index("\0")])) or 1
        raise ConfigError(f"{path}:{line}: holds a NUL character and is no text, or damaged; save it anew as CSV in UTF-8")
    lines: list[str] = _LINE.findall(text)
    hint = _HINT.fullmatch(lines[0]) if lines else None
    if hint:
        lines[0] = "\n"
    comments = tuple(line.strip() for line in lines if comment and line.lstrip().startswith(comment))
    if comment:
        lines = ["\n" if line.lstrip().startswith(comment) else line for line in lines]
    if score is not None and (made := as_one_table(lines)) is not None:
        lines = made
    elif hint is None and (blank := _blanks_as_tabs(lines, score)) is not None:
        lines = blank
    start, separator = _headings_at(lines, hint[1] if hint else None, score)
    preamble = tuple(line.strip() for line in lines[:start] if line.strip())
    lines[:start] = ["\n"] * start
    newline = "\r\n" if "\r\n" in text else "\n" if "\n" in text or "\r" not in text else "\r"
    headings, rows, numbers, at = _parsed(path, lines, separator)
    headings, rows = _without_empty_columns(path, at, headings, rows)
    rows = [_without_empty_end(row, len(headings)) for row in rows]
    _refuse_ragged(path, headings, rows, numbers)
    return CsvText(
        headings, rows, numbers, at, replace(dialect, separator=separator, newline=newline, hint=hint is not None), preamble, comments
    )


def read_text(path: Path, max_bytes: int) -> str:
    """A text file in UTF-8, UTF-16 or Windows-1252. Raises ConfigError."""
    return _decoded(path, _bytes(path, max_bytes))[0]


def text_of_mappings(rows: Sequence[Mapping[Any, Any]], counted: str) -> CsvText:
    """Mappings of a YAML or JSON list as rows of cells, keys as headings; what a mapping lacks is an empty cell."""
    headings = list(dict.fromkeys(str(key) for row in rows for key in row))
    cells = [{str(key): "" if value is None else str(value) for key, value in row.items()} for row in rows]
    return CsvText(
        headings, [[row.get(h, "") for h in headings] for row in cells], list(range(1, len(rows) + 1)), 1, Dialect(), counted=counted
    )


def _parsed(path: Path, lines: list[str], separator: str) -> tuple[list[str], list[list[str]], list[int], int]:
    """Headings, rows that are not empty, their lines, and the line of the headings."""
    reader = csv.reader(lines, strict=True, delimiter=separator)
    rows, numbers = [], []
    try:
        for row in reader:
            if any(map(str.strip, row)):
                rows.append(row)
                numbers.append(reader.line_num)
    except csv.Error as error:
        raise ConfigError(f"{path}:{reader.line_num}: not a CSV file ({error}); save it as comma-separated text") from None
    if not rows:
        raise ConfigError(f"{path}:1: the file is empty; a header line and at least one row are needed")
    first, *others = rows[0]  # headings may stand behind a mark of comments
    return [first.lstrip("# ").strip(), *(name.strip() for name in others)], rows[1:], numbers[1:], numbers[0]


def _without_empty_columns(path: Path, line: int, headings: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Without the columns at the end that have neither heading nor cells, as spreadsheets write them."""
    keep = len(headings)
    while keep and not headings[keep - 1]:
        keep -= 1
    if keep < len(headings) and all(not any(map(str.strip, row[keep:])) for row in rows):
        rows = [row[:keep] if len(row) == len(headings) else row for row in rows]
        headings = headings[:keep]
    if all(as_number(name) is not None for name in headings):
        raise ConfigError(f"{path}:{line}: the first line holds numbers, so there is no header; write the names of the columns above it")
    for i, name in enumerate(headings, 1):
        if not name:
            raise ConfigError(f"{path}:{line}: column {i} has no heading; name it or remove it")
    if twice := next((name for name in headings if headings.count(name) > 1), None):
        raise ConfigError(f"{path}:{line}: column {twice} appears twice; remove one")
    return headings, rows


def _without_empty_end(row: list[str], width: int) -> list[str]:
    """A row without the empty cells that separators at its end make."""
    while len(row) > width and not row[-1].strip():
        row = row[:-1]
    return row


def _refuse_ragged(path: Path, headings: list[str], rows: list[list[str]], line: list[int]) -> None:
    for row, number in zip(rows, line, strict=True):
        if len(row) != len(headings):
            raise ConfigError(
                f"{path}:{number}: column {headings[min(len(row), len(headings) - 1)]}: the row has {len(row)} cells, "
                f"the header {len(headings)}; correct the row (decimal point and comma, or decimal comma and semicolon)"
            )


def _blanks_as_tabs(lines: Sequence[str], score: Callable[[Sequence[str]], tuple[int, bool]] | None) -> list[str] | None:
    """A table whose columns stand apart by blanks, with tabs in their place; None if it has separators, or rows of different lengths.

    Its headings may be behind a mark of comments (``# x y z``), a unit may stand apart from its name (``X [mm]``).
    """
    rows = [i for i, line in enumerate(lines) if line.strip()]
    first = next((k for k, i in enumerate(rows) if k and _numeric(_words(lines[i]))), None)
    if first is None:
        return None
    words = _words(lines[rows[first]])
    headings = [_words(re.sub(r"^[#%/;]+", "", lines[i].strip())) for i in rows[:first]]
    fitting = [k for k, cells in enumerate(headings) if len(cells) == len(words) and not _numeric(cells)]
    at = next((k for k in fitting if score is not None and score(headings[k])[1]), fitting[-1] if fitting else None)
    if at is None or len(words) < 2 or any(separator in lines[rows[first]].strip() for separator in SEPARATORS):
        return None
    if any(separator in lines[rows[at]].strip() for separator in SEPARATORS):
        return None
    out = list(lines)
    out[rows[at]] = "\t".join(headings[at]) + "\n"
    for k in range(first, len(rows)):
        out[rows[k]] = "\t".join(_words(lines[rows[k]])) + "\n"
    if score is None:
        out[: rows[at]] = ["\n"] * rows[at]
    return out


def _words(line: str) -> list[str]:
    """Words of a line, each with the bracket of a unit that stands behind it."""
    return [word.strip() for word in re.findall(r"\S+?(?:\s*[\[(][^\])]*[\])])|\S+", line.strip())]


def _numeric(cells: Sequence[str]) -> bool:
    """Whether at least half of the cells are numbers."""
    numbers = sum(re.fullmatch(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?", cell) is not None for cell in cells)
    return len(cells) > 1 and 2 * numbers >= len(cells)


def _headings_at(lines: Sequence[str], hint: str | None, score: Callable[[Sequence[str]], tuple[int, bool]] | None) -> tuple[int, str]:
    """The index of the line of headings, and the separator."""
    allowed = (hint,) if hint else SEPARATORS
    first = next((i for i, line in enumerate(lines) if line.strip()), 0)
    if score is not None:
        for i in range(first, min(len(lines), first + PREAMBLE_LINES)):
            found = {s: score(_cells(lines[i], s)) for s in allowed}
            complete = [s for s in allowed if found[s][1]]
            if complete:
                return i, max(complete, key=lambda s: found[s][0])
    return first, max(allowed, key=_outside_quotes(lines[first]).count) if lines else ","


def _cells(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line.lstrip("# ")], delimiter=separator), [])
    except csv.Error:
        return []


def _outside_quotes(line: str) -> str:
    return re.sub(r'"[^"]*"', "", line)


def _bytes(path: Path, max_bytes: int) -> bytes:
    cure = next((f"save {path.stem}{s} as CSV" for s in SPREADSHEETS if path.with_suffix(s).exists()), "check the path")
    data = bytes_of(path, max_bytes, cure)
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise ConfigError(f"{path}: is a workbook of a spreadsheet, not CSV; save it as CSV")
    return data


def _decoded(path: Path, data: bytes) -> tuple[str, Dialect]:
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"), (codecs.BOM_UTF8, "utf-8")):
        if data.startswith(mark):
            return _strictly(path, data[len(mark) :], encoding), Dialect(encoding=encoding, bom=True)
    if (unmarked := _unmarked_utf16(data)) is not None:
        return _strictly(path, data, unmarked), Dialect(encoding=unmarked)
    try:
        return data.decode("utf-8"), Dialect()
    except UnicodeDecodeError:
        if (text := _windows_text(data)) is not None:
            return text, Dialect(encoding="cp1252")
    return _strictly(path, data, "utf-8"), Dialect()


def _strictly(path: Path, data: bytes, encoding: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        name = "UTF-8" if encoding == "utf-8" else "UTF-16"
        raise ConfigError(f"{path}:{line}: not {name} text (byte 0x{data[error.start]:02x}); save the file as UTF-8") from None


def _unmarked_utf16(data: bytes) -> str | None:
    """UTF-16 without its mark: every second byte of the first line is zero."""
    start = data[:200]
    if len(start) < 8:
        return None
    for encoding, zero, other in (("utf-16-le", start[1::2], start[0::2]), ("utf-16-be", start[0::2], start[1::2])):
        if zero.count(0) > 0.9 * len(zero) and not other.count(0):
            return encoding
    return None


def _windows_text(data: bytes) -> str | None:
    """A table in Windows-1252 whose headings or separators say that a spreadsheet wrote it; elsewhere such bytes are damage."""
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        return None
    first = _outside_quotes(re.split(r"[\r\n]", text, maxsplit=1)[0])
    in_headings = re.split(rb"[\r\n]", data, maxsplit=1)[-1].isascii()
    return text if in_headings or max(SEPARATORS, key=first.count) != "," else None


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[str]], dialect: Dialect | None = None) -> str:
    """Headings and rows as text."""
    dialect = dialect or Dialect()
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator=dialect.newline, delimiter=dialect.separator)
    writer.writerow(columns)
    writer.writerows(rows)
    return out.getvalue()
