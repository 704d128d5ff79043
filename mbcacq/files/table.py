"""The one reader of CSV tables that enter: every cell by its column's name, in the program's unit, or a refusal with file, line and column.

The separator is the comma; the semicolon or the tab of a spreadsheet that writes decimal commas is read as well. Then '1,5' is a number,
and a cell with a point beside such cells is refused, since the point may separate thousands. In a table with commas a quoted '1,5' is read
likewise, but not '1,500'. A cell may have a unit of its own: '90°', '0.4 m', 'pi/2'. Rows of nothing but empty cells are left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.clock import ClockError, is_clock, seconds
from mbcacq.files.csv_text import CsvText, Dialect, csv_text, read_csv_text
from mbcacq.files.table_schema import Column, HeadingError, HeadingMatch, TableSchema, matched, score
from mbcacq.files.table_schema import joint_columns as joint_columns
from mbcacq.files.units import AmbiguousUnit, converted, number_with_unit, same_dimension, unit_in_cells, unit_named

MAX_BYTES = 1 << 30
SHOWN = 24  # headings that an error lists
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")
_WITH_POINT = re.compile(r"\s*[+-]?[\d.,]*\.[\d.,]*([eE][+-]?\d+)?\s*")


@dataclass
class Table:
    """A table as text, with numbers on demand.

    Attributes
    ----------
    path
        Path of the file.
    columns
        Heading -> its cells.
    line
        (rows,) line of each row in the file.
    found
        Name of a column of the schema -> its heading and unit.
    taken
        Headings that were asked for.
    heading_line
        Line of the headings.
    preamble, comments
        Lines before the headings, and lines left out.
    counted
        What ``line`` numbers: 'line', or 'row', 'sphere' .. of a file that has no lines.
    """

    path: Path
    columns: dict[str, tuple[str, ...]]
    line: list[int]
    found: dict[str, HeadingMatch] = field(default_factory=dict)
    schema: TableSchema | None = None
    taken: set[str] = field(default_factory=set)
    heading_line: int = 1
    dialect: Dialect = field(default_factory=Dialect)
    preamble: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    decimal_comma: bool = False
    counted: str = "line"

    def __len__(self) -> int:
        return len(self.line)

    @property
    def unused(self) -> tuple[str, ...]:
        """Headings that no column of the schema took and nobody asked for."""
        used = self.taken | {f.heading for f in self.found.values()}
        return tuple(heading for heading in self.columns if heading not in used)

    def has(self, names: str | Sequence[str]) -> bool:
        """Whether all of these columns are there."""
        return all(name in self.found or name in self.columns for name in ([names] if isinstance(names, str) else names))

    def heading(self, name: str) -> str:
        """The heading of a column, as it stands in the file."""
        return self.found[name].heading if name in self.found else name

    def rows(self, keep: np.ndarray) -> Table:
        """The rows where ``keep`` (rows,) bool holds."""
        at = np.flatnonzero(keep).tolist()
        columns = {heading: tuple(cells[i] for i in at) for heading, cells in self.columns.items()}
        return replace(self, columns=columns, line=[self.line[i] for i in at], taken=set(self.taken))

    def expect_decimals(self, headings: Sequence[str]) -> None:
        """Columns that are no schema's are numbers too: where they have decimal commas, the table has."""
        self.decimal_comma = self.decimal_comma or _has_decimal_commas(self, headings)

    def where(self, row: int, name: str) -> str:
        """File, line and column of a cell, for errors."""
        place = f":{self.line[row]}" if self.counted == "line" else f": {self.counted} {self.line[row]}"
        return f"{self.path}{place}: column {self.heading(name)}"

    @property
    def at_headings(self) -> str:
        """File and line of the headings, for errors."""
        return f"{self.path}:{self.heading_line}" if self.counted == "line" else str(self.path)

    def names_unit(self, name: str) -> bool:
        """Whether the file says in which unit a column of the schema is."""
        return name in self.found and not self.found[name].assumed

    def require(self, names: Sequence[str]) -> None:
        """Raise ConfigError where a column is missing."""
        missing = [self._preferred(name) for name in names if not self.has(name)]
        if missing:
            _refuse_missing(self, missing)

    def text(self, name: str) -> tuple[str, ...]:
        """The cells of a column."""
        self.require([name])
        heading = self.heading(name)
        self.taken.add(heading)
        return self.columns[heading]

    def number(self, name: str, *, empty: float | None = None) -> np.ndarray:
        """(rows,) float64 in the unit of the schema. empty: value of an empty cell. Raises ConfigError at the first cell that is no finite
        number."""
        cells = self._decimals(name, self.text(name))
        blank = np.array([not cell.strip() for cell in cells], dtype=bool) if empty is not None else np.zeros(len(cells), dtype=bool)
        if blank.any():
            cells = tuple("0" if none else cell for cell, none in zip(cells, blank, strict=True))
        try:
            values = np.array(cells, dtype=float)
        except ValueError:
            values = np.full(len(cells), np.nan)
        own: dict[int, float] = {}
        if not np.isfinite(values).all() or any("_" in cell for cell in cells):
            own = self._with_own_units(name, cells)
            cells = tuple("0" if row in own else cell for row, cell in enumerate(cells))
            self._refuse_number(name, cells)
            values = np.array(cells, dtype=float)
        values = self._in_unit(name, values, cells)
        values[list(own)] = list(own.values())
        if empty is not None:
            values = np.where(blank, empty, values)
        return values

    def time(self, name: str) -> np.ndarray:
        """(rows,) s of a column of numbers, times of day or dates; see ``mbcacq.files.clock``."""
        cells = self.text(name)
        if not any(map(is_clock, cells)):
            return self.number(name)
        try:
            return seconds(cells)
        except ClockError as error:
            raise ConfigError(f"{self.where(error.row, name)}: '{_short(cells[error.row])}' {error}; correct it") from None

    def numbers(self, names: Sequence[str], *, empty: float | None = None, angle: bool = False) -> np.ndarray:
        """(rows, len(names)) of several columns; angle: from deg to rad."""
        return np.stack([self.radians(name) if angle else self.number(name, empty=empty) for name in names], axis=1)

    def integer(self, name: str) -> np.ndarray:
        """(rows,) int64. '3' and '3.0' are accepted, '3.5' is not."""
        values = self.number(name)
        bad = (values != np.rint(values)) | (np.abs(values) > 2**53)
        if bad.any():
            row = int(np.argmax(bad))
            raise ConfigError(f"{self.where(row, name)}: '{_short(self.text(name)[row])}' is not an integer; correct it")
        return values.astype(np.int64)

    def radians(self, name: str) -> np.ndarray:
        """(rows,) float64 rad from a column in deg, where no schema says so."""
        return converted(self.number(name), "deg", "rad", self._decimals(name, self.text(name)))

    def rest(self) -> dict[str, np.ndarray]:
        """The columns that were not read, as text with decimal points."""
        return {
            name: np.array([_with_point(cell) if self.decimal_comma else cell for cell in cells], dtype=np.str_)
            for name, cells in self.columns.items()
            if name not in self.taken
        }

    def with_columns(self, more: Mapping[str, Sequence[str]]) -> bytes:
        """The file with further columns (numbers with decimal points), in its own encoding, separator, decimal mark and line ends."""
        number = re.compile(r"[+-]?\d+\.\d+(?:[eE][+-]?\d+)?")
        decimal = self.decimal_comma
        added = [[cell.replace(".", ",") if decimal and number.fullmatch(cell) else cell for cell in cells] for cells in more.values()]
        rows = zip(*self.columns.values(), *added, strict=True)
        hint = f"sep={self.dialect.separator}{self.dialect.newline}" if self.dialect.hint else ""
        return self.dialect.encoded(hint + csv_text([*self.columns, *more], list(rows), self.dialect))

    def _decimals(self, name: str, cells: tuple[str, ...]) -> tuple[str, ...]:
        """Cells with decimal points. Raises ConfigError if a number has a point beside decimal commas."""
        if not self.decimal_comma:
            return cells
        for row, cell in enumerate(cells):
            if self.dialect.separator == "," and _THOUSANDS.fullmatch(cell):
                raise ConfigError(
                    f"{self.where(row, name)}: '{_short(cell)}' may have a decimal comma or one of thousands; write it with a point"
                )
            if _WITH_POINT.fullmatch(cell):
                raise ConfigError(
                    f"{self.where(row, name)}: '{_short(cell)}' has a point in a file with decimal commas; "
                    "save it without separators of thousands, with one kind of decimal mark"
                )
        return tuple(map(_with_point, cells))

    def _in_unit(self, name: str, values: np.ndarray, cells: Sequence[str]) -> np.ndarray:
        column = self._column(name)
        unit = self.found[name].unit if name in self.found else None
        if column is None or column.unit is None or unit is None:
            return values
        values = converted(values, unit, column.unit, cells)
        if not np.isfinite(values).all():
            row = int(np.argmax(~np.isfinite(values)))
            raise ConfigError(f"{self.where(row, name)}: '{_short(cells[row])}' is out of range; correct it")
        return values

    def _with_own_units(self, name: str, cells: Sequence[str]) -> dict[int, float]:
        """Row -> value in the column's unit, of cells that state their own unit."""
        column = self._column(name)
        if column is None or column.unit is None:
            return {}
        found = {row: pair for row, cell in enumerate(cells) if (pair := number_with_unit(cell))}
        return {
            row: float(converted(np.array([value]), unit, column.unit)[0])
            for row, (value, unit) in found.items()
            if np.isfinite(value) and same_dimension(unit, column.unit)
        }

    def _column(self, name: str) -> Column | None:
        return next((c for c in self.schema.columns if name in (c.name, c.preferred)), None) if self.schema else None

    def _preferred(self, name: str) -> str:
        column = self._column(name)
        return column.preferred if column else name

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
                mark = "; a decimal comma needs the semicolon or the tab between columns" if _DECIMAL_COMMA.fullmatch(cell) else ""
                raise ConfigError(f"{where}: '{_short(cell)}' is not a number; correct it{mark}")
            if not np.isfinite(value):
                raise ConfigError(f"{where}: '{_short(cell)}' is not a finite number; remove the row or correct it")


def read_table(
    path: Path | str,
    schema: TableSchema | None = None,
    *,
    names: Mapping[str, str] | None = None,
    headings: Callable[[Sequence[str]], bool] | None = None,
) -> Table:
    """Read a CSV file in UTF-8, UTF-16 or (from a spreadsheet) Windows-1252.

    Parameters
    ----------
    path
        Path of the file.
    schema
        Columns by their names, with units; without one the columns are named by their headings and numbers have no unit.
    names
        What the file calls a column -> the heading that is to be read in its place.
    headings
        Whether a line is that of the headings, where a table has no schema; lines before it are allowed then.

    Raises
    ------
    ConfigError
        The file is absent, empty, no text or too large; a row has more or fewer cells than the headings; a required column is missing; a
        heading names no unit, a wrong one or one of two meanings.
    """
    path = Path(path)
    if schema is None:
        judged = (lambda cells: (len(cells), headings(cells))) if headings is not None else None
        return _table(path, _renamed(path, read_csv_text(path, max_bytes=MAX_BYTES, score=judged), names))
    scored = (lambda headings: score(schema.columns, headings)) if schema.preamble else None
    text = _renamed(path, read_csv_text(path, max_bytes=schema.max_bytes, comment=schema.comment, score=scored), names)
    return as_table(path, text, schema)


def as_table(path: Path, text: CsvText, schema: TableSchema) -> Table:
    """Headings and rows as the columns of a schema; see ``read_table``."""
    table = _table(path, text)
    table.schema = schema
    try:
        found = matched(schema.columns, text.headings)
    except HeadingError as error:
        raise ConfigError(f"{table.at_headings}: {error}") from None
    table.found = found | {c.preferred: found[c.name] for c in schema.columns if c.name in found}
    missing = [column.preferred for column in schema.columns if column.required and column.name not in found]
    if missing:
        _refuse_missing(table, missing)
    _take_units(table, schema)
    numbers = [match.heading for name, match in found.items() if (column := table._column(name)) and column.kind != "text"]
    table.decimal_comma = any("," in cell and _DECIMAL_COMMA.fullmatch(cell) for heading in numbers for cell in table.columns[heading])
    return table


def _renamed(path: Path, text: CsvText, names: Mapping[str, str] | None) -> CsvText:
    if not names:
        return text
    headings = [names.get(heading, heading) for heading in text.headings]
    if twice := next((h for h in headings if headings.count(h) > 1), None):
        raise ConfigError(f"{path}:{text.heading_line}: two columns are called {twice}, one by columns:; correct that or the heading")
    return replace(text, headings=headings)


def _table(path: Path, text: CsvText) -> Table:
    if not text.rows:
        raise ConfigError(f"{path}:{text.heading_line + 1}: there are no rows below the header; at least one is needed")
    columns = dict(zip(text.headings, zip(*text.rows, strict=True), strict=True))
    table = Table(
        path,
        columns,
        text.line,
        heading_line=text.heading_line,
        dialect=text.dialect,
        preamble=text.preamble,
        comments=text.comments,
        counted=text.counted,
    )
    table.decimal_comma = _has_decimal_commas(table, list(columns))
    return table


def _has_decimal_commas(table: Table, headings: Sequence[str]) -> bool:
    return table.dialect.separator != "," and any(_DECIMAL_COMMA.fullmatch(cell) for h in headings for cell in table.columns[h])


def _take_units(table: Table, schema: TableSchema) -> None:
    """Give every column its unit: of the heading, of a line of units below it, or the one assumed. Raises ConfigError for a required
    column that has none."""
    silent = [
        c
        for c in schema.columns
        if c.unit is not None and c.kind == "number" and c.name in table.found and table.found[c.name].unit is None
    ]
    below = _units_below(table) if silent else None
    for column in silent:
        heading = table.found[column.name].heading
        stated = (below or {}).get(heading)
        unit = stated or column.assumed or unit_in_cells(table.columns[heading], column.unit or "")
        if not unit and not column.required:  # another thing of that name, perhaps: it counts as unused
            table.found.pop(column.name)
            table.found.pop(column.preferred, None)
            continue
        if not unit:
            raise ConfigError(
                f"{table.at_headings}: column {column.preferred} is missing: column {heading} names no unit; "
                f"name it so if it is in {column.written or column.unit}, else with its own unit in brackets"
            )
        if not same_dimension(unit, column.unit or ""):
            raise ConfigError(f"{table.at_headings}: column {heading} cannot be given in {unit}; correct the unit")
        table.found[column.name] = table.found[column.preferred] = HeadingMatch(heading, unit, assumed=not stated)


def _units_below(table: Table) -> dict[str, str] | None:
    """Heading -> unit of a first row that holds nothing but units, which is taken away; None if it is a row of data."""
    out: dict[str, str] = {}
    for heading, cells in table.columns.items():
        plain = cells[0].strip().strip("[]()")
        try:
            unit = unit_named(plain) if plain not in ("", "-", "1") else ""
        except AmbiguousUnit as error:
            raise ConfigError(f"{table.where(0, heading)}: '{plain}' may be {error}; write which") from None
        if unit is None:
            return None
        out[heading] = unit
    if len(table) < 2 or not any(out.values()):
        return None
    table.columns = {heading: cells[1:] for heading, cells in table.columns.items()}
    table.line = table.line[1:]
    return out


def _refuse_missing(table: Table, missing: Sequence[str]) -> None:
    there = list(table.columns)
    more = ", ..." if len(there) > SHOWN else ""
    kind = f"; {table.schema.what} needs it" if table.schema else ""
    listed = ", ".join(map(_short, there[:SHOWN])) + more
    raise ConfigError(f"{table.at_headings}: column {', '.join(missing)} is missing (the header has: {listed}){kind}; add it")


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell


def _short(cell: str) -> str:
    return cell if len(cell) <= 40 else cell[:37] + "..."
