"""Angles between radians in memory and decimal degrees in text, without losing a bit.

Multiplying by pi/180 in float64 does not reach every float64 angle, so a decimal of more than 17 significant digits is converted exactly
instead. Such a decimal is written where no shorter one reads back as the same angle.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Context, Decimal

import numpy as np

_CONTEXT = Context(prec=40)
_DEGREE = _CONTEXT.divide(Decimal("3.1415926535897932384626433832795028841971693993751"), Decimal(180))
_LONG = 18


def radians(degrees: np.ndarray, text: Sequence[str]) -> np.ndarray:
    """(k,) float64 rad from deg values and the decimals they were read from."""
    out = np.radians(degrees)
    for i, cell in enumerate(text):
        if len(cell) >= _LONG and _significant(cell) >= _LONG:
            out[i] = float(_CONTEXT.multiply(Decimal(cell.strip()), _DEGREE))
    return out


def degrees_text(angle: np.ndarray) -> list[str]:
    """The shortest decimals (deg) that ``radians`` turns back into ``angle`` (k,) rad, bit for bit."""
    angle = np.asarray(angle, dtype=float)
    best, found = degrees(angle)
    text = list(map(repr, best.tolist()))
    for i in np.flatnonzero(~found):
        text[i] = _exact(float(angle[i]))
    return text


def degrees(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """deg values with few decimals whose ``np.radians`` is ``angle``, and a mask of where one exists (elsewhere the nearest)."""
    angle = np.asarray(angle, dtype=float)
    plain = np.degrees(angle)
    best, found = plain.copy(), np.zeros(angle.shape, dtype=bool)
    candidates = [np.round(plain, digits) for digits in range(0, 14)]
    candidates += [plain, np.nextafter(plain, np.inf), np.nextafter(plain, -np.inf)]
    for candidate in candidates:
        hit = ~found & (np.radians(candidate) == angle)
        best[hit] = candidate[hit]
        found |= hit
    return best, found


def _exact(angle: float) -> str:
    value = _CONTEXT.divide(Decimal(angle), _DEGREE)
    return format(Context(prec=_LONG + 1).plus(value), "f")


def _significant(cell: str) -> int:
    mantissa = re.split("[eE]", cell.strip(), maxsplit=1)[0]
    return len(mantissa.replace(".", "").lstrip("+-").lstrip("0"))
