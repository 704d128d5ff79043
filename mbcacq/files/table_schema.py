"""What a table of a kind holds: its columns with names, units and kinds, and which heading of a file is which column."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from mbcacq.files.units import AmbiguousUnit, same_dimension, suffix_unit, unit_named

_BRACKETS = re.compile(r"([^\[\](]+)[\s_]*[\[(]([^\[\]]*)[\])]\s*")
_COVERAGE = re.compile(r"[,;\s]*\bk\s*=\s*(\d+(?:[.,]\d+)?)\s*[,;]?")
_EMPTY_BRACKETS = re.compile(r"\s*[\[(]\s*[\])]")
_BEHIND_WORD = re.compile(r"(.+?)(?: in | ?/ ?)(\S+)\s*")

# Names of a joint's angle beside q1, by what controllers and other programs write.
JOINT_NAMES = ("a{}", "j{}", "joint{}", "joint_{}", "axis{}", "axis_{}", "achse{}", "achse_{}")

KEPT_HEADING = 80  # characters
_IN_HEADINGS = {"degC": "C", "ppm/K": "ppm_per_K"}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name
        By which the program asks for it.
    unit
        Unit of the array, as pint spells it; None for a number without unit, an integer or a text.
    kind
        'number', 'integer' or 'text'.
    written
        Unit that the preferred heading names, ``unit`` if empty: ('q1', 'rad', written 'deg') is best headed ``q1_deg``.
    aliases
        Other names in headings, in the order of preference.
    required
        Whether a table without it is refused.
    assumed
        Unit of a heading that names none; empty: such a heading is refused. Where one is assumed, a word in brackets that is no unit is
        refused.
    assumed_of_aliases
        The same of a heading that is one of the aliases: a controller's ``A1`` is in deg, where ``q1`` alone says nothing.
    """

    name: str
    unit: str | None = None
    kind: Literal["number", "integer", "text"] = "number"
    written: str = ""
    aliases: tuple[str, ...] = ()
    required: bool = True
    assumed: str = ""
    assumed_of_aliases: str = ""

    @property
    def preferred(self) -> str:
        """The heading that documents and errors name."""
        unit = self.written or self.unit
        return f"{self.name}_{_IN_HEADINGS.get(unit, unit.replace('*', '').replace('/', '_'))}" if unit else self.name


@dataclass(frozen=True)
class TableSchema:
    """A kind of table.

    Attributes
    ----------
    what
        In words, for errors: 'a table of recordings'.
    columns
        Each a ``Column``.
    max_bytes
        Largest size of the file.
    comment
        Mark of lines that are left out; empty: there are none.
    preamble
        Whether lines may stand before the headings.
    """

    what: str
    columns: tuple[Column, ...]
    max_bytes: int = 64 << 20
    comment: str = ""
    preamble: bool = False


@dataclass(frozen=True)
class HeadingMatch:
    """A column of a file. heading: as in the file; unit: that it names, None if it names none; assumed: whether the unit stands in
    ``Column.assumed`` alone."""

    heading: str
    unit: str | None
    assumed: bool = False


class HeadingError(ValueError):
    """A heading that cannot be understood without guessing; the text says why and what to do."""


def joint_columns(
    name: str,
    n: int,
    *,
    unit: str | None = "rad",
    written: str = "deg",
    aliases: Sequence[str] = (),
    required: bool = True,
    assumed: str = "",
    form: str = "{name}{i}",
) -> tuple[Column, ...]:
    """One column for each of n joints, q1 to qn. aliases: with {} in place of the joint's number."""
    return tuple(
        Column(
            form.format(name=name, i=i),
            unit,
            written=written,
            aliases=tuple(alias.format(i) for alias in aliases),
            required=required,
            assumed=assumed,
        )
        for i in range(1, n + 1)
    )


def coverage_factor(text: str) -> float | None:
    """k of an expanded uncertainty, where a heading or a comment states it: ``U (k=2)``."""
    found = _COVERAGE.search(text)
    return float(found[1].replace(",", ".")) if found else None


def matched(columns: Sequence[Column], headings: Sequence[str]) -> dict[str, HeadingMatch]:
    """Column name -> its heading. Raises HeadingError if two headings are equally good, or a unit is of the wrong kind."""
    out: dict[str, HeadingMatch] = {}
    free = list(headings)
    for column in columns:
        found = ((h, _hit_of(column, h) if len(h) <= KEPT_HEADING else _hit_of.__wrapped__(column, h)) for h in free)  # none long is kept
        ranked = sorted((hit[0], heading, hit[1]) for heading, hit in found if hit)
        if not ranked:
            continue
        rank, heading, unit = ranked[0]
        if len(ranked) > 1 and ranked[1][0] == rank:
            raise HeadingError(f"columns {heading} and {ranked[1][1]} both give {column.preferred}; remove one")
        by_alias = column.assumed_of_aliases if rank >= 2 and not unit else ""
        out[column.name] = HeadingMatch(heading, unit or by_alias or None, assumed=bool(by_alias))
        free.remove(heading)
    return out


def score(columns: Sequence[Column], headings: Sequence[str]) -> tuple[int, bool]:
    """How many columns these headings give, and whether all required ones are among them."""
    try:
        found = matched(columns, [heading.strip() for heading in headings])
    except HeadingError:
        return 1, True  # understood well enough to be refused with its reason
    return len(found), bool(found) and all(column.name in found for column in columns if column.required)


@lru_cache(maxsize=4096)
def _hit_of(column: Column, heading: str) -> tuple[int, str] | None:
    """Rank (0 is best) and unit ('' if none is named) of a heading as this column; None if it is another."""
    names = (column.name, *column.aliases)
    keys = _keys(column)
    for base, unit, bracket in _readings(column, heading):
        key = _key(base)
        if key not in keys:
            continue
        rank = 2 * keys.index(key) + (heading != column.preferred and heading not in names and base not in names)
        if column.unit is None or not unit:
            return rank, ""
        if same_dimension(unit, column.unit):
            return rank, unit
        if bracket:
            raise HeadingError(f"column {heading}: {column.preferred} cannot be given in {unit}; correct the unit")
    return None


def _readings(column: Column, heading: str) -> list[tuple[str, str, bool]]:
    """Name, unit ('' for none) and whether the unit is marked as one, in the ways that a heading may be read."""
    heading = _EMPTY_BRACKETS.sub("", _COVERAGE.sub("", heading)).strip()
    out = [(heading, "", False)]
    marked = _BRACKETS.fullmatch(heading) or _BEHIND_WORD.fullmatch(heading)
    if marked:
        base, unit = _without_suffix(marked[1].strip().rstrip("_"), column), marked[2]
        named = _named(column, heading, unit) if _key(base) in _keys(column) else None
        out.append((base, named or "", named is not None))
    parts = re.split(r"[_ ]", heading)
    for cut in range(1, len(parts)):
        unit = suffix_unit("_".join(parts[cut:]))
        if unit is not None:
            out.append(("_".join(parts[:cut]), unit, False))
    return out


def _named(column: Column, heading: str, text: str) -> str | None:
    if column.unit is None:
        return None
    try:
        unit = unit_named(text)
    except AmbiguousUnit as error:
        raise HeadingError(f"column {heading}: '{text}' may be {error}; name the column {column.preferred}") from None
    if unit is None and column.assumed and text.strip():
        raise HeadingError(
            f"column {heading}: '{text}' is no unit that can be given in {column.written or column.unit}; correct the heading"
        )
    return unit


def _without_suffix(name: str, column: Column) -> str:
    """What stands before both units of a heading that says its unit twice, 'x_mm [mm]'; any other heading as it is."""
    base, _, unit = name.rpartition("_")
    return base if base and suffix_unit(unit) and _key(base) in _keys(column) else name


@lru_cache(maxsize=1024)
def _keys(column: Column) -> tuple[str, ...]:
    """The names of a column as headings are compared; every heading of a table is compared with every column."""
    return tuple(map(_key, (column.name, *column.aliases)))


def _key(name: str) -> str:
    return re.sub(r"[\s_\-]+", "_", name.strip()).casefold().strip("_")
