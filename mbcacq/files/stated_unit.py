"""The unit of length that words in a file state for all of it: 'Units: mm', 'all dimensions in inch', 'X [m]'."""

from __future__ import annotations

import re

from mbcacq.errors import ConfigError
from mbcacq.files.units import AmbiguousUnit, same_dimension, suffix_unit, unit_named

_UNITS = re.compile(
    r"\b(?:units?|einheit(?:en)?)\b([^\w\n]*)(?:(?:of[ \t]+)?length[^\w\n]*)?(?:(?:in|of|is|are|ist|sind)[ \t]+)?([A-Za-zµμ]+)",
    re.IGNORECASE,
)
# The same in a sentence: 'All dimensions in inch'. An uncertainty or a range may be in µm or m, which are therefore no unit of all.
_SAID = re.compile(
    r"(?:\bin|\b(?:dimension|length|coordinate|value|ma(?:ß|ss)|wert)\w*\W*[:=])\s+(inch(?:es)?|zoll|mm|millimet(?:er|re)s?|cm)\b",
    re.IGNORECASE,
)
_OF_AXES = re.compile(
    r"(?<![A-Za-z0-9])[xyz][ \t]*(?:[\[(][ \t]*([^\])\n]{1,12}?)[ \t]*[\])]|_([A-Za-zµμ]{1,4})(?![A-Za-z0-9_]))", re.IGNORECASE
)


def stated_unit(text: str, where: str) -> str:
    """The unit of length, in pint's words, that lines of text state for all numbers of a file; '' without any.

    Raises ConfigError, beginning with ``where``, for a unit that is no length, and for two different ones.
    """
    found = [unit for match in _UNITS.finditer(text) if (unit := _named(match, where))]
    found += [unit for word in _SAID.findall(text) if (unit := unit_named(word))]
    if len(units := list(dict.fromkeys(found))) > 1:
        raise ConfigError(f"{where}: the lines above the numbers speak of {' and of '.join(map(in_words, units))}; write one: # units: mm")
    return units[0] if units else ""


def unit_of_axes(headings: str, where: str) -> str:
    """The unit of length of headings such as 'X [mm], Y [mm]' or 'x_m y_m z_m'; '' without any. Raises ConfigError as ``stated_unit``."""
    words = [bracketed or behind for bracketed, behind in _OF_AXES.findall(headings)]
    units = list(dict.fromkeys(_length(word) for word in words))
    if len(units) > 1 or None in units:
        raise ConfigError(f"{where}: the headings name {' and '.join(map(repr, dict.fromkeys(words)))}, which is no one unit of length")
    return units[0] or "" if units else ""


def in_words(unit: str | None) -> str:
    """A unit in a sentence."""
    return "inches" if unit == "in" else str(unit)


def _named(match: re.Match[str], where: str) -> str | None:
    """The unit of 'units: mm'; None for 'unit sphere', which states none."""
    unit = _length(match[2])
    if unit is None and re.search("[:=]", match[1]) and not _angle(match[2]):
        raise ConfigError(f"{where}: the unit '{match[2]}' is no length that is known; give mm, cm, m, um or inch")
    return unit


def _angle(word: str) -> bool:
    unit = suffix_unit(word)
    return unit is not None and same_dimension(unit, "deg")


def _length(word: str) -> str | None:
    try:
        unit = unit_named(word)
    except AmbiguousUnit:
        return None
    return unit if unit is not None and same_dimension(unit, "mm") else None
