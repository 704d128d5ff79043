"""Tables of points: joint angles or poses of the flange, a row a point; written with the corrected angles beside them.

Comma, semicolon or tab; decimal commas beside semicolons and tabs; UTF-8, UTF-16, Windows-1252. What is written has all of it as it was.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.heading_units import UnknownUnitError, converted, split_heading

MAX_BYTES = 64 << 20
POSE = (("x", "mm"), ("y", "mm"), ("z", "mm"), ("a", "rad"), ("b", "rad"), ("c", "rad"))
SEPARATORS = (",", ";", "\t")
MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*")
_NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*")


@dataclass(frozen=True)
class PointTable:
    """q: (P, n) rad, NaN where a row gives a pose alone; goals: (P, 4, 4) mm of the flange in the base, or None; lines: (P,).

    rows: the header and all rows as text; separator, comma, line_end, mark, encoding: how they are written.
    """

    q: np.ndarray
    goals: np.ndarray | None
    lines: tuple[int, ...]
    notes: tuple[str, ...]
    rows: list[list[str]]
    separator: str
    comma: bool
    line_end: str
    mark: bytes
    encoding: str

    def written(self, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]) -> bytes:
        """The table with columns of the corrected angles q (P, n) rad, empty where a point is not reached."""
        out = io.StringIO(newline="")
        writer = csv.writer(out, delimiter=self.separator, lineterminator=self.line_end)
        more = [f"corrected_q{i + 1}_deg" for i in range(q.shape[1])]
        writer.writerow([*self.rows[0], *more, "residual_mm", "reached", "reason"])
        for row, angles, error, ok, reason in zip(self.rows[1:], np.degrees(q), errors_mm, reached, reasons, strict=True):
            values = [self._decimal(v) for v in angles] if ok else [""] * len(angles)
            writer.writerow([*row, *values, self._decimal(error), str(bool(ok)).lower(), reason])
        return self.mark + out.getvalue().encode(self.encoding)

    def _decimal(self, value: float) -> str:
        text = f"{value + 0.0:.6f}"
        return text.replace(".", ",") if self.comma else text


def read_points(path: Path, n: int) -> PointTable:
    """The points of a table for an arm of n axes. Raises ConfigError naming file, line and column."""
    text, mark, encoding = _text(path)
    separator = max(SEPARATORS, key=re.split(r"\r\n|\r|\n", text, maxsplit=1)[0].count)
    line_end = "\r\n" if "\r\n" in text else "\n" if "\n" in text or "\r" not in text else "\r"
    rows, lines = _rows(path, text, separator)
    header = [split_heading(heading)[:2] for heading in rows[0]]
    comma = separator != "," and any(_DECIMAL_COMMA.fullmatch(cell) for row in rows[1:] for cell in row)
    joints = _columns(header, [(f"q{i}", f"a{i}", f"j{i}", f"joint{i}", f"joint_{i}") for i in range(1, n + 1)])
    pose = _columns(header, [(name,) for name, _ in POSE])
    if joints is None and pose is None:
        raise ConfigError(
            f"{path}:1: has neither q1_deg..q{n}_deg nor x_mm, y_mm, z_mm, a_deg, b_deg, c_deg (separated by '{separator}' it has "
            f"{', '.join(rows[0])[:200]}); name the columns so"
        )
    table = _Cells(path, rows, lines, comma)
    q = np.full((len(lines), n), np.nan)
    if joints is not None:
        q = np.stack([table.column(c, header[c][1] or "deg", "rad") for c in joints], axis=1)
        _refuse_radians(path, rows[0], [rows[0][c] for c in joints], q, any(header[c][1] for c in joints))
    goals = None
    if pose is not None:
        for c, (name, unit) in zip(pose, POSE, strict=True):
            if not header[c][1]:
                raise ConfigError(f"{path}:1: column '{rows[0][c]}' says no unit; name it {name}_{'mm' if unit == 'mm' else 'deg'}")
        values = np.stack([table.column(c, header[c][1], unit) for c, (_, unit) in zip(pose, POSE, strict=True)], axis=1)
        goals = np.array([se3.from_abc(row[:3], row[3:]) for row in values])
    return PointTable(q, goals, tuple(lines), (), rows, separator, comma, line_end, mark, encoding)


def _refuse_radians(path: Path, header: list[str], names: list[str], q: np.ndarray, stated: bool) -> None:
    """Joint angles without a unit that are all within 2 pi: radians, or an arm that hardly moves."""
    degrees = np.degrees(q)
    uneven = np.abs(2 * degrees - np.round(2 * degrees)) > 1e-6
    if not stated and np.abs(degrees).max(initial=0.0) <= 2 * np.pi and np.count_nonzero(uneven) >= 2:
        raise ConfigError(f"{path}: all joint angles are within 2 pi and {names[0]} says no unit; name the columns q1_rad.. or q1_deg..")


def _rows(path: Path, text: str, separator: str) -> tuple[list[list[str]], list[int]]:
    """The header and the rows, and the line of each row. Raises ConfigError for one of another length."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if rows and not any(cell.strip() for cell in row):
                raise ConfigError(f"{path}:{reader.line_num}: is empty; remove the line")
            if rows and len(row) != len(rows[0]):
                raise ConfigError(
                    f"{path}:{reader.line_num}: the row has {len(row)} cells, the header {len(rows[0])}; correct the row (decimal point "
                    "and comma, or decimal comma and semicolon)"
                )
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise ConfigError(f"{path}:{reader.line_num}: is not a CSV file ({error}); save it as comma-separated text") from None
    if len(rows) < 2:
        raise ConfigError(f"{path}: has no points; give a header and one line a point")
    return rows, lines[1:]


@dataclass(frozen=True)
class _Cells:
    path: Path
    rows: list[list[str]]
    lines: list[int]
    comma: bool

    def column(self, number: int, unit: str, wanted: str) -> np.ndarray:
        """(P,) of a column in the unit that is wanted. Raises ConfigError at the first cell that is no number."""
        heading = self.rows[0][number]
        try:
            factor = converted(1.0, unit, wanted)
        except UnknownUnitError:
            raise ConfigError(
                f"{self.path}:1: '{unit}' in '{heading}' is no unit that can be given in {wanted}; correct the heading"
            ) from None
        return factor * np.array([self._value(row[number], line, heading) for row, line in zip(self.rows[1:], self.lines, strict=True)])

    def _value(self, cell: str, line: int, heading: str) -> float:
        plain = cell.replace(",", ".") if self.comma and _DECIMAL_COMMA.fullmatch(cell) else cell
        if self.comma and "." in cell:
            raise ConfigError(
                f"{self.path}:{line}: column {heading}: '{cell[:40]}' has a point in a file with decimal commas; correct the cell"
            )
        if not _NUMBER.fullmatch(plain) or not np.isfinite(float(plain)):
            what = (
                "is empty"
                if not cell.strip()
                else "is not finite"
                if cell.strip().lower().lstrip("+-") in ("nan", "inf")
                else "is no number"
            )
            raise ConfigError(f"{self.path}:{line}: column {heading}: '{cell[:40]}' {what}; correct the line")
        return float(plain)


def _columns(header: list[tuple[str, str]], wanted: list[tuple[str, ...]]) -> list[int] | None:
    names = [name for name, _ in header]
    found = [next((names.index(name) for name in some if name in names), None) for some in wanted]
    return None if any(f is None for f in found) else [f for f in found if f is not None]


def _text(path: Path) -> tuple[str, bytes, str]:
    """Text, mark of the byte order and encoding of a file."""
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give a robot program or a CSV file") from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; split it")
    mark, encoding = next((pair for pair in MARKS if raw.startswith(pair[0])), (b"", "utf-8"))
    try:
        text = raw[len(mark) :].decode(encoding)
    except UnicodeDecodeError:
        text, encoding = raw.decode("latin-1"), "latin-1"
    if "\0" in text:
        raise ConfigError(f"{path}: holds a NUL character, so that it is no text; save it as CSV")
    return text, mark, encoding
