"""Units in headings and keys, by pint: ``U (µm)``, ``x_cm``, ``alpha [1/K]``, ``theta in deg``."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

# What people write and pint reads otherwise, or does not read.
SPELLINGS = {
    "°": "degree",
    "µm": "um",
    "μm": "um",
    "°c": "degC",
    "c": "degC",
    "°f": "degF",
    "f": "degF",
    "k": "kelvin",
    "zoll": "inch",
    "inches": "inch",
    "in": "inch",
    '"': "inch",
    "ppm_per_k": "ppm/kelvin",
    "ppm/k": "ppm/kelvin",
    "1e-6/k": "ppm/kelvin",
    "1e-6_k": "ppm/kelvin",
    "10^-6/k": "ppm/kelvin",
    "µm/m/k": "ppm/kelvin",
    "um/m/k": "ppm/kelvin",
    "µm/(m·k)": "ppm/kelvin",
    "um/(m*k)": "ppm/kelvin",
    "1/k": "1/kelvin",
    "/k": "1/kelvin",
    "1/°c": "1/kelvin",
    "1/c": "1/kelvin",
    "ppm/°c": "ppm/kelvin",
}
PLAIN = frozenset(
    "m mm cm dm um nm inch ft foot feet deg degree degrees rad radian radians mrad degC degF kelvin meter metre millimeter".split()
)
_BRACKETS = re.compile(r"^(.*?)\s*[\(\[]\s*(.*?)\s*[\)\]]\s*$", re.DOTALL)
_COVERAGE = re.compile(r"k\s*=\s*(\d+(?:[.,]\d+)?)")
_SPELT = re.compile(r"(?:1/)?[A-Za-zµμ]{1,16}(?:[*/][A-Za-zµμ]{1,16}){0,2}")


class UnknownUnitError(ValueError):
    """What stands where a unit should stand is none, or one of something else."""


def unit_of(text: str) -> str | None:
    """pint's word for a unit that is spelt, None for a text that is none."""
    plain = text.strip()
    found = SPELLINGS.get(plain.lower().replace(" ", ""))
    if found is None and plain.casefold() in {word.casefold() for word in PLAIN}:
        found = next(word for word in sorted(PLAIN) if word.casefold() == plain.casefold())
    return found


def split_heading(heading: str) -> tuple[str, str, float | None]:
    """Name, unit (pint's word, or what stands in brackets and is none, '' without any) and coverage factor k of a heading."""
    name, unit, coverage = heading.strip(), "", None
    if match := _BRACKETS.match(name):
        name, inside = match[1], match[2]
        if k := _COVERAGE.search(inside):
            coverage = float(k[1].replace(",", "."))
            inside = _COVERAGE.sub("", inside).strip(" ,;")
        unit = unit_of(inside) or inside
    elif " in " in name and unit_of(name.rsplit(" in ", 1)[1]):
        name, unit = name.rsplit(" in ", 1)[0], str(unit_of(name.rsplit(" in ", 1)[1]))
    else:
        for separator in ("_", " ", "/"):
            # From the longest ending on: alpha_ppm_per_K ends in ppm_per_K.
            cuts = [i for i, letter in enumerate(name) if letter == separator and i > 0]
            cut = next((i for i in cuts if unit_of(name[i + 1 :])), None)
            if cut is not None:
                name, unit = name[:cut], str(unit_of(name[cut + 1 :]))
                break
    return name.strip().lower().replace(" ", "_"), unit, coverage


def converted(value: float, unit: str, wanted: str) -> float:
    """The number in the unit that is wanted. Raises UnknownUnitError where it cannot be given in it."""
    if unit == wanted:
        return value
    import pint

    known = unit_of(unit) or unit
    if not _SPELT.fullmatch(known):  # nothing else goes to pint, which would evaluate it
        raise UnknownUnitError(f"'{unit}' is no unit that can be given in {wanted}")
    try:
        angle = "radian" in str(_registry().get_root_units(_registry().parse_units(known))[1])
        if angle != (wanted in ("rad", "deg")):
            raise UnknownUnitError(unit)
        return float(_registry().Quantity(value, known).m_as(wanted))
    except (pint.PintError, ValueError, TypeError, AttributeError):
        raise UnknownUnitError(f"'{unit}' is no unit that can be given in {wanted}") from None


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
