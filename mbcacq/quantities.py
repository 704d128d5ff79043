"""Quantities as people read them: digits that follow the uncertainty, SI symbols; terminal, report, viewer and notebooks write them here.

After the GUM (JCGM 100, 7.2.6) an uncertainty has two significant digits, and its value ends at the same decimal place. Every uncertainty
that is shown is expanded, U with k = 2. The minus is the typographic one; the terminal, from which numbers are copied, writes a hyphen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

DEGREE = math.pi / 180  # rad: 5 * DEGREE is an angle of five degrees
K = 2.0  # coverage factor of every uncertainty that is shown
MOST_PLACES = 7  # after the decimal point; what is smaller gets a power of ten
LEAST_P = 1e-6  # a smaller p-value rests on tails of a distribution that nobody knows so far out
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Ending of a parameter's name: symbol of the unit that is shown, and its number for one of the unit that is stored.
UNITS = {
    "rad_per_Nm": ("µrad/(N·m)", 1e6),
    "rad_per_Nm2": ("µrad/(N·m)²", 1e6),
    "rad_per_kg": ("µrad/kg", 1e6),
    "mm_per_rad": ("mm/rad", 1.0),
    "mm_per_N": ("µm/N", 1e3),
    "mm_per_K": ("µm/K", 1e3),
    "rad_per_K": ("µrad/K", 1e6),
    "ppm_per_K": ("ppm/K", 1.0),
    "Nms_per_rad": ("N·m·s/rad", 1.0),
    "rad_per_Nms": ("rad/(N·m·s)", 1.0),
    "Nm_per_rad": ("N·m/rad", 1.0),
    "rad_per_s": ("rad/s", 1.0),
    "per_mm": ("1/mm", 1.0),
    "per_mm2": ("1/mm²", 1.0),
    "per_s": ("1/s", 1.0),
    "per_K": ("ppm/K", 1e6),
    "kg_mm": ("kg·mm", 1.0),
    "deg_per_s": ("°/s", 1.0),
    "deg_s": ("°/s", 1.0),
    "Nm": ("N·m", 1.0),
    "um": ("µm", 1.0),
    "urad": ("µrad", 1.0),
    "deg": ("°", 1.0),
    "mm": ("mm", 1.0),
    "rad": ("µrad", 1e6),
    "ppm": ("ppm", 1.0),
    "ms": ("ms", 1.0),
    "kg": ("kg", 1.0),
    "N": ("N", 1.0),
    "s": ("s", 1.0),
    "K": ("K", 1.0),
    "C": ("°C", 1.0),
}
SYMBOLS = {stored: symbol for stored, (symbol, factor) in UNITS.items() if factor == 1.0} | {"deg/s": "°/s", "N m": "N·m"}


def in_degrees(angle: Any) -> Any:
    """An angle, or an array of them, from rad to deg: as people and files read it."""
    import numpy as np

    return np.degrees(angle)


def from_degrees(angle: Any) -> Any:
    """An angle, or an array of them, from deg to rad: of what people and files say."""
    import numpy as np

    return np.radians(angle)


def decimal_places(expanded: float) -> int:
    """Decimal places that show two significant digits of an expanded uncertainty; negative for tens and hundreds."""
    places = 1 - math.floor(math.log10(expanded))
    return places - 1 if round(expanded, places) >= 10.0 ** (2 - places) else places  # 0.0996 becomes 0.10


def fixed(value: float | None, places: int = 3) -> str:
    """Fixed point with a typographic minus; a dash for a value that is not there.

    Parameters
    ----------
    value
        In the unit of the text around it.
    places
        Decimal places; below zero tens, hundreds are rounded.
    """
    if value is None or not math.isfinite(value):
        return "–"
    rounded = round(float(value), places) + 0.0  # a zero has no sign
    return f"{rounded:.{max(places, 0)}f}".replace("-", "−")


def signed(value: float | None, places: int = 3) -> str:
    """``fixed`` with a plus before what is above zero."""
    text = fixed(value, places)
    return text if text == "–" or text.startswith("−") or not text.strip("0.") else f"+{text}"


def capitalised(text: str) -> str:
    """With a capital letter at its begin."""
    return text[:1].upper() + text[1:]


def significant(value: float | None, digits: int = 3) -> str:
    """A value whose uncertainty is not known, to a number of significant digits; a power of ten only where zeros would fill the line."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -5 < power < 6:
        return f"{fixed(value / 10.0**power, digits - 1)} × 10{str(power).translate(_SUPERSCRIPT)}"
    return fixed(value, digits - 1 - power)


def pair(value: float | None, expanded: float | None) -> tuple[str, str]:
    """A value and its expanded uncertainty, both ending at the second digit of the uncertainty; '–' for one that is not known.

    A value without an uncertainty has four significant digits.
    """
    if value is None or not math.isfinite(value) or not expanded or not math.isfinite(expanded):
        return significant(value, 4), "–"
    places = decimal_places(expanded)
    if places > MOST_PLACES:  # both with the power of ten of the larger one
        power = math.floor(math.log10(max(abs(value), expanded)))
        shown = (fixed(one / 10.0**power, places + power) for one in (value, expanded))
        first, second = (f"{one} × 10{str(power).translate(_SUPERSCRIPT)}" for one in shown)
        return first, second
    return fixed(value, places), fixed(expanded, places)


def measured(value: float | None, expanded: float | None, unit: str = "") -> str:
    """'0.261 ± 0.056 mm'; without an uncertainty only value and unit."""
    shown, uncertainty = pair(value, expanded)
    text = shown if uncertainty == "–" else f"{shown} ± {uncertainty}"
    if not unit:
        return text
    # One unit belongs to both numbers (SI brochure, 5.4.5), which shows without brackets unless it is a degree sign.
    return with_unit(f"({text})" if unit == "°" and uncertainty != "–" else text, unit)


def with_unit(number: str, unit: str) -> str:
    """A number that is written already, with its unit; a degree sign stands at the number (SI brochure, 5.4.3)."""
    return f"{number}{unit}" if unit == "°" else f"{number} {unit}".rstrip()


def uncertainty(expanded: float | None) -> str:
    """An expanded uncertainty by itself: two significant digits."""
    return significant(expanded, 2) if expanded else "–"


def p_value(p: float) -> str:
    """'p = 0.013', or 'p < 10⁻⁶' where the figure itself would say nothing."""
    if p < LEAST_P:
        return f"p < {power_of_ten(LEAST_P)}"
    return f"p = {fixed(p, 2) if p >= 0.1 else significant(p, 2)}"


def power_of_ten(value: float) -> str:
    """'10⁻⁶' of 1e-6; the nearest power."""
    return f"10{str(round(math.log10(value))).translate(_SUPERSCRIPT)}"


def percent(share: float) -> str:
    """A share in whole percent. A share below 1 % has a tenth too, so that it does not look like nothing."""
    return f"{share:.1%}" if 0.0005 <= share < 0.0095 else f"{share:.0%}"


def micrometres(mm: float | None) -> str:
    """A small length (mm) in µm: three significant digits, at least one decimal place from 10 µm on downwards."""
    return "–" if mm is None or not math.isfinite(mm) else f"{fixed(1e3 * mm, 1)} µm"


def split_unit(name: str) -> tuple[str, str, float]:
    """Words, unit symbol and factor of a parameter by the ending of its name.

    'A2.compliance_rad_per_Nm' gives ('A2 compliance', 'µrad/(N·m)', 1e6): one of the stored unit is so many of the one shown.
    """
    for ending in sorted(UNITS, key=len, reverse=True):
        if name.endswith("_" + ending):
            return in_words(name[: -len(ending) - 1]), *UNITS[ending]
    return in_words(name), "", 1.0


def symbol(unit: str) -> str:
    """The symbol of a unit as files write it: '°' of 'deg'; others as they are."""
    return SYMBOLS.get(unit, unit)


def in_words(name: str) -> str:
    """A name of a file or of a parameter as words: underscores and points become spaces."""
    return name.replace("_", " ").replace(".", " ")


def listed(values: Sequence[float], places: int = 1) -> str:
    """Several values of one unit, with commas: '2.9, 3.0, 5.2'."""
    return ", ".join(fixed(v, places) for v in values)
