"""Units as headings spell them, and numbers in the unit that the program computes in (by pint)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np

from mbcacq.files import angles

# What pint reads differently from people who write headings, or does not read; left in lower case where that is unambiguous.
SPELLINGS = {
    "°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "radian": "rad", "°c": "degC", "c": "degC", "degc": "degC",
    "celsius": "degC", "deg_c": "degC", "°f": "degF", "f": "degF", "degf": "degF", "k": "K", "kelvin": "K", "nm": "N*m", "n*m": "N*m",
    "n.m": "N*m", "n·m": "N*m", "knm": "kN*m", "nmm": "N*mm", "a": "A", "amp": "A", "ma": "mA", "v": "V", "n": "N", "w": "W",
    "percent": "percent", "%": "percent", "µm": "um", "μm": "um", "inch": "in", "inches": "in", "zoll": "in", "millimeter": "mm",
    "millimetre": "mm", "millimeters": "mm", "millimetres": "mm", "meter": "m", "metre": "m", "meters": "m", "metres": "m", "sec": "s",
    "seconds": "s", "min": "min", "h": "h", "1e-6/k": "ppm/K", "1/k": "1/K",
    "10^-6/k": "ppm/K", "ppm/k": "ppm/K", "ppm_per_k": "ppm/K", "µm/m/k": "ppm/K", "µm/(m*k)": "ppm/K", "deg_s": "deg/s",
    "°/s": "deg/s", "rad_s": "rad/s", "mm_s": "mm/s", "m_s": "m/s", '"': "in", "/k": "1/K", "1/°c": "1/K", "1/c": "1/K",
    "ppm/°c": "ppm/K", "1e-6_k": "ppm/K", "um/m/k": "ppm/K", "um/(m*k)": "ppm/K", "µm/(m·k)": "ppm/K",
}  # fmt: skip
SPELLINGS |= {spelt.casefold(): unit for spelt, unit in SPELLINGS.items()}  # the micro sign becomes a Greek letter
# Units that a heading may end in behind '_' or a blank: a short list, since a word such as 'point' is a unit too.
SUFFIXES = frozenset(
    "mm cm dm m um in ft deg rad mrad arcsec arcmin gon s ms us min h degC degF K N*m kN*m N*mm A mA percent kg g N V W ppm/K 1/K".split()
    + ["deg/s", "rad/s", "mm/s", "m/s"]
)
_WORD = r"[A-Za-zµμ°]{1,16}(?:\^-?[1-9]|\*\*-?[1-9])?"
_UNIT = re.compile(rf"{_WORD}(?:[*/·.]{_WORD}){{0,3}}")  # nothing else goes to pint, which evaluates powers of powers
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_UNIT = re.compile(rf"({_NUMBER})\s*([^\d\s.,+\-][^,]*)")
_PI = re.compile(r"([-+]?)\s*(\d+(?:\.\d+)?)?\s*\*?\s*(?:pi|π)\s*(?:/\s*(\d+(?:\.\d+)?))?", re.IGNORECASE)
_ZERO = re.compile(r"[+-]?0*[.,]?0*")
AMBIGUOUS = {"grad": "degrees (deg) or gon", "grd": "degrees (deg) or gon"}


class AmbiguousUnit(ValueError):
    """A unit that different people read differently; the text names what it may be."""


def unit_named(text: str) -> str | None:
    """The unit that a text spells, in pint's words; None if it spells none. Raises AmbiguousUnit for 'Grad'."""
    plain = text.strip()
    if plain.casefold() in AMBIGUOUS:
        raise AmbiguousUnit(AMBIGUOUS[plain.casefold()])
    if plain == "nm":  # of lengths; Nm is a torque
        return "nm"
    known = SPELLINGS.get(plain) or SPELLINGS.get(plain.casefold().replace(" ", ""))
    if known is not None:
        return known
    for attempt in (plain, plain.casefold()):
        if attempt in SUFFIXES:
            return attempt
    return plain if _UNIT.fullmatch(plain) and _parsed(plain) is not None else None


def number_with_unit(cell: str) -> tuple[float, str] | None:
    """A number and the unit that stand in one cell: '90°', '0.4 m', '-pi/2'; None if the text is something else."""
    plain = cell.strip()
    if match := _PI.fullmatch(plain):
        divisor = float(match[3] or 1)
        size = float(match[2] or 1) * np.pi / divisor if divisor else np.nan
        return (-size if match[1] == "-" else size), "rad"
    match = _WITH_UNIT.fullmatch(plain)
    try:
        unit = unit_named(match[2]) if match else None
    except AmbiguousUnit:
        return None
    return (float(match[1]), unit) if match and unit else None


def unit_in_cells(cells: Sequence[str], wanted: str) -> str:
    """The wanted unit, where all cells that are not zero state one of its kind ('-pi/2', '90°', '0.4 m'); '' if they do not."""
    own = [number_with_unit(cell) for cell in cells]
    stated = [pair[1] for pair in own if pair]
    silent = any(pair is None and not _ZERO.fullmatch(cell.strip()) for pair, cell in zip(own, cells, strict=True))
    return wanted if stated and not silent and all(same_dimension(unit, wanted) for unit in stated) else ""


def suffix_unit(text: str) -> str | None:
    """The unit that a heading ends in; None if the text is no usual unit."""
    try:
        unit = unit_named(text) if len(text) <= 12 else None
    except AmbiguousUnit:
        return None
    return unit if unit in SUFFIXES else None


@lru_cache(maxsize=4096)
def same_dimension(unit: str, other: str) -> bool:
    """Whether numbers in one unit can be given in the other. An angle is no plain number here."""
    if unit == other:
        return True
    first, second = _parsed(unit), _parsed(other)
    return first is not None and second is not None and first.dimensionality == second.dimensionality and _angle(first) == _angle(second)


def converted(values: np.ndarray, unit: str, wanted: str, text: Sequence[str] = ()) -> np.ndarray:
    """(rows,) in ``wanted`` from (rows,) in ``unit``. text: the decimals they were read from, for angles without a lost bit."""
    if unit == wanted:
        return values
    if (unit, wanted) in (("deg", "rad"), ("deg/s", "rad/s")):
        return angles.radians(values, text)
    return np.asarray(_registry().Quantity(values, _parsed(unit)).m_as(wanted), dtype=float)


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=4096)
def _parsed(unit: str) -> Any:
    """The unit of pint; None if the text is none."""
    import pint

    try:
        return _registry().parse_units(unit.replace("·", "*").replace(".", "*"))
    except (pint.PintError, ValueError):
        return None


def _angle(unit: Any) -> bool:
    """Whether a unit is an angle, or an angle per something: to pint these have no dimension of their own."""
    return "radian" in str(_registry().get_root_units(unit)[1])
