"""Tables of points: joint angles or poses of the flange, a row a point; written with the corrected angles beside them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3

MAX_BYTES = 64 << 20
POSE = ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")


@dataclass(frozen=True)
class PointTable:
    """q: (P, n) rad, NaN where a row gives a pose alone; goals: (P, 4, 4) mm of the flange in the base, or None; lines: (P,)."""

    q: np.ndarray
    goals: np.ndarray | None
    lines: tuple[int, ...]
    notes: tuple[str, ...]
    text: str

    def written(self, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]) -> bytes:
        """The table with columns of the corrected angles q (P, n) rad, empty where a point is not reached."""
        return _write_csv(self.text, q, errors_mm, reached, reasons).encode("latin-1")


def read_points(path: Path, n: int) -> PointTable:
    """The points of a table for an arm of n axes. Raises ConfigError naming file, line and column."""
    text = _text(path)
    rows = list(csv.reader(io.StringIO(text)))
    if len(rows) < 2:
        raise ConfigError(f"{path}: has no points; give a header and one line a point")
    header = [h.strip().lower() for h in rows[0]]
    joints = _columns(header, [[f"q{i}_deg", f"a{i}", f"q{i}"] for i in range(1, n + 1)])
    pose = _columns(header, [[name] for name in POSE])
    if joints is None and pose is None:
        raise ConfigError(f"{path}:1: has neither q1_deg..q{n}_deg nor {', '.join(POSE)}; name the columns so")
    q, goals, lines = [], [], []
    for number, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            raise ConfigError(f"{path}:{number}: is empty; remove the line")
        q.append(np.radians(_values(path, number, row, joints)) if joints is not None else np.full(n, np.nan))
        lines.append(number)
        if pose is not None:
            v = _values(path, number, row, pose)
            goals.append(se3.from_abc(v[:3], np.radians(v[3:])))
    return PointTable(np.array(q), np.array(goals) if goals else None, tuple(lines), (), text)


def _columns(header: list[str], wanted: list[list[str]]) -> list[int] | None:
    found = [next((header.index(name) for name in names if name in header), None) for names in wanted]
    return None if any(f is None for f in found) else [f for f in found if f is not None]


def _values(path: Path, number: int, row: list[str], columns: list[int]) -> np.ndarray:
    try:
        values = np.array([float(row[c]) for c in columns])
    except (ValueError, IndexError):
        raise ConfigError(f"{path}:{number}: a value is missing or no number; correct the line") from None
    if not np.all(np.isfinite(values)):
        raise ConfigError(f"{path}:{number}: a value is not finite; correct the line")
    return values


def _write_csv(text: str, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]) -> str:
    rows = list(csv.reader(io.StringIO(text)))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n" if "\r\n" in text else "\n")
    more = [f"corrected_q{i + 1}_deg" for i in range(q.shape[1])]
    writer.writerow([*rows[0], *more, "residual_mm", "reached", "reason"])
    for row, angles, error, ok, reason in zip(rows[1:], np.degrees(q), errors_mm, reached, reasons, strict=True):
        values = [f"{v + 0.0:.6f}" for v in angles] if ok else [""] * len(angles)
        writer.writerow([*row, *values, f"{error:.6f}", str(bool(ok)).lower(), reason])
    return out.getvalue()


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()[: MAX_BYTES + 1]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give a robot program or a CSV file") from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; split it")
    return raw.decode("latin-1")
