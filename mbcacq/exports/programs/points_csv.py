"""Tables of points: joint angles or poses of the flange, a row a point; written with the corrected angles beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.csv_text import read_csv_text
from mbcacq.files.table import Column, Table, TableSchema, as_table, joint_columns
from mbcacq.files.table_schema import JOINT_NAMES, HeadingError, matched
from mbcacq.geometry import se3
from mbcacq.quantities import in_degrees
from mbcacq.recording.datasets.csv_columns import refuse_radians

MAX_BYTES = 64 << 20
POSE = tuple(Column(axis, "mm") for axis in "xyz") + tuple(Column(angle, "rad", written="deg") for angle in "abc")
WHAT = "a table of points"


@dataclass(frozen=True)
class PointTable:
    """q: (P, n) rad, NaN where a row gives a pose alone; goals: (P, 4, 4) mm of the flange in the base, or None; table: as it was read."""

    q: np.ndarray
    goals: np.ndarray | None
    table: Table

    @property
    def lines(self) -> tuple[int, ...]:
        """(P,) line of each point."""
        return tuple(self.table.line)

    def written(self, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]) -> bytes:
        """The table with columns of the corrected angles q (P, n) rad, empty if a point is not reached."""
        more = {
            f"corrected_q{i + 1}_deg": [_decimal(angle) if ok else "" for angle, ok in zip(column, reached, strict=True)]
            for i, column in enumerate(in_degrees(q).T)
        }
        more |= {
            "residual_mm": list(map(_decimal, errors_mm)),
            "reached": [str(bool(ok)).lower() for ok in reached],
            "reason": list(reasons),
        }
        return self.table.with_columns(more)


def read_points(path: Path, n: int) -> PointTable:
    """The points of a table for an arm of n axes. Raises ConfigError naming file, line and column."""
    text = read_csv_text(path, max_bytes=MAX_BYTES)
    joints = joint_columns("q", n, aliases=JOINT_NAMES, assumed="deg")
    has_joints, has_pose = (_has(path, columns, text.headings) for columns in (joints, POSE))
    if not has_joints and not has_pose:
        raise ConfigError(
            f"{path}:{text.heading_line}: has neither q1_deg..q{n}_deg nor x_mm, y_mm, z_mm, a_deg, b_deg, c_deg (separated by "
            f"'{text.dialect.separator}' it has {', '.join(text.headings)[:200]}); name the columns so"
        )
    table = as_table(path, text, TableSchema(WHAT, (joints if has_joints else ()) + (POSE if has_pose else ())))
    q = np.full((len(table), n), np.nan)
    if has_joints:
        q = table.numbers([column.name for column in joints])
        refuse_radians(table, in_degrees(q), named=True)
    goals = None
    if has_pose:
        goals = np.array([se3.from_abc(row[:3], row[3:]) for row in table.numbers([column.name for column in POSE])])
    return PointTable(q, goals, table)


def _has(path: Path, columns: Sequence[Column], headings: Sequence[str]) -> bool:
    try:
        return len(matched(columns, headings)) == len(columns)
    except HeadingError as error:
        raise ConfigError(f"{path}:1: {error}") from None


def _decimal(value: float) -> str:
    return f"{value + 0.0:.6f}"
