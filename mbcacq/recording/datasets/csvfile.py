"""CSV tables (RFC 4180, with a header) column by column, with file, line and column in every error message.

The separator is the comma; the semicolon or the tab of a spreadsheet that writes decimal commas is read as well: then '1,5' is a number,
and a cell with a point beside such cells is refused, since the point may separate thousands. Such a table may be in Windows-1252 or
UTF-16 too, and rows of nothing but empty cells are left out of it.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.recording.datasets import angles, quaternions
from mbcacq.recording.datasets.synced_files import write_synced

MAX_BYTES = 1 << 30
SPREADSHEETS = (".xlsx", ".xls", ".ods")
XYZ = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
SEPARATORS = (",", ";", "\t")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
_WITH_POINT = re.compile(r"\s*[+-]?[\d.,]*\.[\d.,]*([eE][+-]?\d+)?\s*")


@dataclass
class CsvTable:
    """A CSV file as text. columns: header name -> cells of that column; line: (rows,) line of each row in the file."""

    path: Path
    columns: dict[str, tuple[str, ...]]
    line: list[int]
    taken: set[str] = field(default_factory=set)

    def __len__(self) -> int:
        return len(self.line)

    def renamed(self, columns: Mapping[str, str]) -> CsvTable:
        """The table with columns called by names of this program, given those of the file. Raises ConfigError for one that is not there."""
        known = {old: new for new, old in columns.items() if old in self.columns}
        for old, new in known.items():
            if new in self.columns and new != old and new not in known:
                raise ConfigError(f"{self.path}:1: there is a column {new} already, and columns: gives {old} that name; remove one")
        return replace(self, columns={known.get(name, name): cells for name, cells in self.columns.items()})

    def has(self, names: Sequence[str]) -> bool:
        return all(name in self.columns for name in names)

    def rows(self, keep: np.ndarray) -> CsvTable:
        """The rows where ``keep`` (rows,) bool holds."""
        at = np.flatnonzero(keep).tolist()
        return CsvTable(self.path, {n: tuple(cells[i] for i in at) for n, cells in self.columns.items()}, [self.line[i] for i in at])

    def where(self, row: int, column: str) -> str:
        return f"{self.path}:{self.line[row]}: column {column}"

    def require(self, names: Sequence[str]) -> None:
        missing = [name for name in names if name not in self.columns]
        if missing:
            raise ConfigError(f"{self.path}:1: column {', '.join(missing)} is missing (the header has: {', '.join(self.columns)}); add it")

    def text(self, name: str) -> tuple[str, ...]:
        self.require([name])
        self.taken.add(name)
        return self.columns[name]

    def number(self, name: str) -> np.ndarray:
        """(rows,) float64. Raises ConfigError at the first cell that is no finite number."""
        cells = self.text(name)
        try:
            values = np.array(cells, dtype=float)
        except ValueError:
            values = np.full(len(cells), np.nan)
        if not np.isfinite(values).all() or any("_" in cell for cell in cells):
            self._refuse_number(name, cells)
        return values

    def integer(self, name: str) -> np.ndarray:
        """(rows,) int64. '3' and '3.0' are accepted, '3.5' is not."""
        values = self.number(name)
        bad = (values != np.rint(values)) | (np.abs(values) > 2**53)
        if bad.any():
            row = int(np.argmax(bad))
            raise ConfigError(f"{self.where(row, name)}: '{self.columns[name][row]}' is not an integer; correct it")
        return values.astype(np.int64)

    def radians(self, name: str) -> np.ndarray:
        """(rows,) float64 rad from a column in deg."""
        return angles.radians(self.number(name), self.columns[name])

    def group(self, names: Sequence[str], *, angle: bool = False) -> np.ndarray:
        """(rows, len(names)) of several columns."""
        return np.stack([self.radians(name) if angle else self.number(name) for name in names], axis=1)

    def rotations(self) -> np.ndarray:
        """(rows, 3, 3) from the columns ``QUATERNION``. Raises ConfigError at the first whose length is not 1."""
        q = self.group(QUATERNION)
        length = np.linalg.norm(q, axis=1)
        bad = np.abs(length - 1) > 0.01
        if bad.any():
            row = int(np.argmax(bad))
            raise ConfigError(f"{self.where(row, 'qw')}: qw, qx, qy, qz have length {length[row]:.4g}, not 1; correct the quaternion")
        return quaternions.to_matrix(q)

    def rest(self) -> dict[str, np.ndarray]:
        """The columns that were not read, as text."""
        return {name: np.array(cells, dtype=np.str_) for name, cells in self.columns.items() if name not in self.taken}

    def _refuse_number(self, name: str, cells: Sequence[str]) -> None:
        for row, cell in enumerate(cells):
            where = self.where(row, name)
            if not cell.strip():
                raise ConfigError(f"{where}: the cell is empty; fill it in, or leave the whole column out if it is optional")
            try:
                value = float(cell)
            except ValueError:
                value = None
            if value is None or "_" in cell:
                raise ConfigError(f"{where}: '{_short(cell)}' is not a number; correct it")
            if not np.isfinite(value):
                raise ConfigError(f"{where}: '{_short(cell)}' is not a finite number; remove the row or correct it")


def read_table(path: Path) -> CsvTable:
    """Read a CSV file. Raises ConfigError if it is absent, empty, not UTF-8, or a row has more or fewer cells than the header."""
    text = _text(path)
    separator = _separator(text)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    rows, line = [], []
    try:
        header = [name.strip() for name in next(reader, [])]
        for row in reader:
            if row and (separator == "," or any(map(str.strip, row))):
                rows.append(row)
                line.append(reader.line_num)
    except csv.Error as error:
        raise ConfigError(f"{path}:{reader.line_num}: not a CSV file ({error}); save it as comma-separated text") from None
    if not header:
        raise ConfigError(f"{path}:1: the file is empty; a header line and at least one row are needed")
    for name in header:
        if header.count(name) > 1:
            raise ConfigError(f"{path}:1: column {name} appears twice; remove one")
    _refuse_ragged(path, header, rows, line)
    if not rows:
        raise ConfigError(f"{path}:2: there are no rows below the header; at least one is needed")
    if separator != ",":
        rows = _decimal_points(path, header, rows, line)
    return CsvTable(path, dict(zip(header, zip(*rows, strict=True), strict=True)), line)


def _refuse_ragged(path: Path, header: list[str], rows: list[list[str]], line: list[int]) -> None:
    for row, number in zip(rows, line, strict=True):
        if len(row) != len(header):
            raise ConfigError(
                f"{path}:{number}: column {header[min(len(row), len(header) - 1)]}: the row has {len(row)} cells, "
                f"the header {len(header)}; correct the row (decimal point and comma, or decimal comma and semicolon)"
            )


def _separator(text: str) -> str:
    """The one of ``SEPARATORS`` that the header has most of."""
    header = text.split("\n", 1)[0]
    return max(SEPARATORS, key=header.count)


def _decimal_points(path: Path, header: list[str], rows: list[list[str]], line: list[int]) -> list[list[str]]:
    """The rows with decimal points, where they have decimal commas. Raises ConfigError where a number has a point beside decimal commas."""
    if not any(_DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row):
        return rows
    for row, number in zip(rows, line, strict=True):
        for name, cell in zip(header, row, strict=True):
            if _WITH_POINT.fullmatch(cell):
                raise ConfigError(
                    f"{path}:{number}: column {name}: '{_short(cell)}' has a point in a file with decimal commas; "
                    "save it without separators of thousands, with one kind of decimal mark"
                )
    return [[cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in row] for row in rows]


def write_table(path: Path, columns: Mapping[str, Sequence[str]]) -> None:
    """Write columns of text as one CSV file; an existing file is replaced only when the new one is complete."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, buffer.getvalue())


def write_text(path: Path, text: str) -> None:
    """Write a file as UTF-8; an existing one is replaced only when the new one is complete. Raises RecordingError."""
    write_synced(path, text.encode("utf-8"))


def numbered(pattern: str, n: int) -> list[str]:
    """Column names with the joint's number, 1..n, in place of {}."""
    return [pattern.format(i + 1) for i in range(n)]


def numbers(values: np.ndarray) -> list[str]:
    """Shortest decimals that read back as the same bits."""
    return list(map(repr, np.asarray(values).tolist()))


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; split the set")
        data = path.read_bytes()
    except OSError as error:
        cure = next((f"save {path.stem}{s} as CSV" for s in SPREADSHEETS if path.with_suffix(s).exists()), "check the path")
        raise ConfigError(f"{path} cannot be read: {error.strerror}; {cure}") from None
    try:
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return data.decode("utf-16")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if (text := _windows_text(data)) is not None:
            return text
        line = data[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: not UTF-8 text (byte 0x{data[error.start]:02x}); save the file as UTF-8") from None


def _windows_text(data: bytes) -> str | None:
    """A table in Windows-1252 that separates by semicolons or tabs, as spreadsheets do; in any other such bytes are damage."""
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        return None
    return None if _separator(text) == "," else text


def _short(cell: str) -> str:
    return cell if len(cell) <= 40 else cell[:37] + "..."
