"""Times as logs write them: seconds, clock times, dates; as seconds that rise over midnight."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

DAY_S, HALF_DAY_S = 86_400.0, 43_200.0
FIRST_EPOCH_S, LAST_EPOCH_S = 6.3e8, 4.1e9  # 1990 and 2100, since 1970
_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,]\d+)?))?"
_ZONE = r"(?:\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2}))?"
_ISO = re.compile(rf"(?P<Y>\d{{4}})[-/.](?P<M>\d{{1,2}})[-/.](?P<D>\d{{1,2}})(?:[T\s]+{_CLOCK}{_ZONE})?")
_DOTS = re.compile(rf"(?P<D>\d{{1,2}})\.(?P<M>\d{{1,2}})\.(?P<Y>\d{{4}})(?:,?\s+{_CLOCK}{_ZONE})?")
_US = re.compile(rf"(?P<M>\d{{1,2}})/(?P<D>\d{{1,2}})/(?P<Y>\d{{4}}),?\s+{_CLOCK}\s*(?P<half>[AP])\.?M\.?", re.IGNORECASE)
_TIME = re.compile(_CLOCK)
_SLASHES = re.compile(r"\d{1,2}/\d{1,2}/\d{2,4}.*")


class ClockError(ValueError):
    """Row and cell that are no time, and why."""

    def __init__(self, row: int, why: str) -> None:
        super().__init__(why)
        self.row = row


def is_clock(cell: str) -> bool:
    """Whether a cell looks like a date or a time of day, and not like a number."""
    return any(pattern.fullmatch(cell.strip()) for pattern in (_ISO, _DOTS, _TIME, _US, _SLASHES))


def seconds(cells: Sequence[str]) -> np.ndarray:
    """(k,) s: since 1970 (UTC, or the clock of who wrote them) of dates, since midnight of times of day, which go on over midnight.

    Raises ClockError for a cell that is neither, of the other kind than the first, or a date with the month before or behind the day.
    """
    found = [_second(row, cell.strip()) for row, cell in enumerate(cells)]
    dated = np.array([day is not None for day, _ in found], dtype=bool)
    if dated.any() and not dated.all():
        raise ClockError(int(np.argmax(dated != dated[0])), "has a date where others have a time of day alone")
    if dated.all():
        return np.array([float(day or 0.0) + s for day, s in found])
    of_day = np.array([s for _, s in found])
    return of_day + DAY_S * np.cumsum(np.r_[0.0, np.diff(of_day) < -DAY_S / 2])


def _second(row: int, cell: str) -> tuple[float | None, float]:
    """Seconds of the date since 1970, None without one, and those within the day."""
    if match := _US.fullmatch(cell):  # AM and PM stand behind dates with the month first
        return _day(row, match), _of_day(match) % HALF_DAY_S + HALF_DAY_S * (match["half"].upper() == "P")
    if _SLASHES.fullmatch(cell):
        raise ClockError(row, "may be day/month or month/day; write dates as 2026-11-25")
    for pattern in (_ISO, _DOTS):
        if match := pattern.fullmatch(cell):
            return _day(row, match) - _zone(match["zone"]), _of_day(match) if match["h"] else 0.0
    if match := _TIME.fullmatch(cell):
        return None, _of_day(match)
    raise ClockError(row, "is no number, time of day or date")


def _day(row: int, match: re.Match[str]) -> float:
    """s from 1970 to the day of a date."""
    try:
        return datetime(int(match["Y"]), int(match["M"]), int(match["D"]), tzinfo=UTC).timestamp()
    except ValueError:
        raise ClockError(row, "is no day of the calendar") from None


def _of_day(match: re.Match[str]) -> float:
    return 3600.0 * int(match["h"]) + 60.0 * int(match["m"]) + float((match["s"] or "0").replace(",", "."))


def _zone(text: str | None) -> float:
    if not text or text in ("Z", "UTC"):
        return 0.0
    digits = text[1:].replace(":", "")
    size = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
    return -size if text[0] == "-" else size


def in_seconds(times: np.ndarray) -> np.ndarray:
    """Times (rows,) s; those since 1970 that are too large for s by far are in ms, us or ns, as ROS and cameras write them."""
    smallest = float(np.min(times, initial=np.inf))
    for factor in (1e3, 1e6, 1e9):
        if FIRST_EPOCH_S < smallest / factor < LAST_EPOCH_S:
            return times / factor
    return times
