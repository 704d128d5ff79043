"""Raw cycles out of the shared ring, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.devices import Cycles
from mbcacq_kuka.rsi.shared import COUNTED, FIXED, Shared
from mbcacq_kuka.rsi.telegram import REPORT_ELEMENT

_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
WATCHED = "Tech.C2"  # C21 to C23: load, tool, base, written by the controller's program as it begins
_RENAMED = {
    "MACur": "current_percent",
    "Delay.D": "delay",
    REPORT_ELEMENT: "digital_outputs",
    "IPOC": "ipoc",
    "EIPos": "external_axes",
    "ESPos": "external_axes_set",
    "MECur": "external_current_percent",
}


class CycleReader:
    """Reads a session's rows exactly once each. ``lost`` counts rows that were overwritten before they were read."""

    def __init__(self, shared: Shared) -> None:
        self._shared: Shared | None = shared
        self._rows = np.empty((0, len(FIXED)))
        self._tail = self.lost = 0
        self._names: list[str] = []
        self._columns: dict[str, Any] = {}
        self._rest = np.empty((0, len(FIXED)))
        self._last = np.zeros(len(FIXED))

    def begin(self) -> None:
        """The session's layout is known: at least one row is there."""
        shared = self._shared
        assert shared is not None  # begin comes before detach
        self._rows = np.frombuffer(shared.ring).reshape(shared.capacity, shared.width)
        self._names = shared.names()
        self._columns = _columns(self._names)
        self.start = self._rows[0][self._columns["q"]].copy()

    def last(self) -> dict[str, Any]:
        """The newest row, also after ``detach``: time_s, flags, command as numbers and q (6,) deg."""
        row = self._last if self._shared is None else self._rows[(self._shared.head - 1) % len(self._rows)].copy()
        return {"time_s": float(row[1]), "flags": row[2], "command": row[3], "q": row[self._columns["q"]]}

    def newest(self, name: str) -> float:
        """A value of the newest row; NaN where the session does not send it."""
        if self._shared is None or name not in self._names:
            return np.nan
        row = self._rows[(self._shared.head - 1) % len(self._rows)]
        return float(row[len(FIXED) + self._names.index(name)])

    def drain(self) -> Cycles:
        """All rows since the last call."""
        return self._convert(self._take()) if self._columns else Cycles({})

    def detach(self) -> None:
        """The block goes away: keep what was not read yet."""
        if self._columns and self._shared is not None:
            self._last = self._rows[(self._shared.head - 1) % len(self._rows)].copy()
            self._rest = self._take()
        self._shared, self._rows = None, np.empty((0, 0))

    def _take(self) -> np.ndarray:
        if self._shared is None:
            rows, self._rest = self._rest, self._rest[:0]
            return rows
        head, capacity = self._shared.head, len(self._rows)
        first = max(self._tail, head - capacity)
        rows = self._rows[np.arange(first, head) % capacity]
        overwritten = min(max(self._shared.head - capacity - first, 0), len(rows))  # while they were being copied
        self.lost += first - self._tail + overwritten
        self._tail = head
        return rows[overwritten:]

    def _convert(self, rows: np.ndarray) -> Cycles:
        columns: dict[str, np.ndarray] = {name: rows[:, where] for name, where in self._columns.items()}
        columns.setdefault("q_set", np.full((len(rows), 6), np.nan))
        for name in ("q", "q_set", "q_command"):
            columns[name] = np.radians(columns[name])
        columns["answered"] = (columns.pop("flags").astype(int) >> 2 & 1).astype(bool)
        return Cycles(columns)


def _columns(names: list[str]) -> dict[str, Any]:
    """Column name -> where it is in a row. Elements with attributes become one (k, n) column under the element's name."""
    offset = len(FIXED)
    where: dict[str, Any] = {name: FIXED.index(name) for name in ("host_time_s", "time_s", "flags")}
    where |= {f"{name}_telegrams": FIXED.index(name) for name in COUNTED}
    where["q_command"] = slice(FIXED.index("cA1"), FIXED.index("cA6") + 1)
    grouped: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        if name.startswith(WATCHED):
            continue  # facts, not cycles
        if name in _RENAMED or "." not in name:
            where[_RENAMED.get(name, name)] = offset + i
        else:
            grouped.setdefault(name.split(".")[0], []).append(offset + i)
    for element, key in (("AIPos", "q"), ("ASPos", "q_set")):
        if all(f"{element}.{a}" in names for a in _AXES):
            where[key] = [offset + names.index(f"{element}.{a}") for a in _AXES]
            grouped.pop(element)
    where.update({_RENAMED.get(element, element): slots for element, slots in grouped.items()})
    return where
