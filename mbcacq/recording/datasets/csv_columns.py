"""Columns of the tables of observation sets and trajectory sets: their names, schemas, and numbers as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.csv_text import csv_text
from mbcacq.files.table import Column, Table, TableSchema
from mbcacq.model.cell import RobotModel
from mbcacq.recording.datasets import quaternions
from mbcacq.recording.datasets.columns_of_joints import schema_of

MAX_BYTES = 1 << 30
XYZ = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
FLANGE_VELOCITY = ("v1_mm_s", "v2_mm_s", "v3_mm_s", "w1_deg_s", "w2_deg_s", "w3_deg_s")  # in the flange's own frame
TIME = Column("time", "s", aliases=("t", "timestamp", "time_stamp", "clock", "date", "datetime", "zeit", "%time"), assumed="s")
MEASURED = (*(Column(axis, "mm", required=False) for axis in "xyz"), *(Column(name, required=False) for name in QUATERNION))


def poses_schema(robot: RobotModel, balls: Sequence[int] = ()) -> TableSchema:
    """poses.csv of a robot; balls: numbers of those that a wide table may have columns of."""
    columns = (
        Column("pose", kind="integer", required=False),
        Column("station", kind="text", required=False),
        Column("phase", kind="text", required=False),
        Column("ball", kind="integer", required=False),
        replace(TIME, required=False),
        Column("sensor_time", "s", required=False),
        *(Column(f"v{axis}", "mm/s", required=False) for axis in "123"),
        *(Column(f"w{axis}", "deg/s", required=False) for axis in "123"),
        Column("payload", "kg", required=False),
        *(column for quantity in ("q", "dir", "qd", "tau", "i") for column in schema_of(robot, quantity)),
        *MEASURED,
        *(Column(f"{axis}{ball}", "mm", required=False) for ball in balls for axis in "xyz"),
    )
    return TableSchema("poses.csv", columns, max_bytes=MAX_BYTES)


CENTRES = TableSchema(
    "centres.csv",
    (
        Column("pose", kind="integer"),
        Column("ball", kind="integer"),
        *(Column(axis, "mm") for axis in "xyz"),
        *(Column(name, required=False) for name in QUATERNION),
        Column("n_points", required=False),
        Column("rms", "mm", required=False),
    ),
    max_bytes=MAX_BYTES,
)


def trajectory_schema(robot: RobotModel) -> TableSchema:
    """trajectory.csv of a robot. Motor currents in A and in percent are two columns, for one cannot be had from the other."""
    return TableSchema(
        "trajectory.csv",
        (
            TIME,
            *(column for form in ("", "_set", "_joint") for column in schema_of(robot, "q", form)),
            *(column for quantity in ("tau", "motor_tau", "i") for column in schema_of(robot, quantity)),
        ),
        max_bytes=MAX_BYTES,
    )


def refuse_radians(table: Table, q: np.ndarray, *, named: bool = False) -> None:
    """Raises ConfigError for joint angles q (rows, n) deg within 2 pi whose headings name no unit: radians, or an arm that hardly moves.

    named: also where the headings say that they are in deg.
    """
    uneven = np.abs(2 * q - np.round(2 * q)) > 1e-6
    if np.abs(q).max(initial=0.0) > 2 * np.pi or np.count_nonzero(uneven) < 2:
        return
    if not any(table.names_unit(f"q{i + 1}") for i in range(q.shape[1])):
        raise ConfigError(
            f"{table.path}: all joint angles are within 2 pi and {table.heading('q1')} says no unit; name the columns q1_rad.. or q1_deg.."
        )
    if named and table.found["q1"].unit == "deg":
        raise ConfigError(f"{table.path}: all joint angles are within 2 pi, which looks like radians; name the columns q1_rad..")


def rotations(table: Table) -> np.ndarray:
    """(rows, 3, 3) from the columns ``QUATERNION``. Raises ConfigError at the first whose length is not 1."""
    q = table.numbers(QUATERNION)
    length = np.linalg.norm(q, axis=1)
    bad = np.abs(length - 1) > quaternions.UNIT
    if bad.any():
        row = int(np.argmax(bad))
        raise ConfigError(f"{table.where(row, 'qw')}: qw, qx, qy, qz have length {length[row]:.4g}, not 1; correct the quaternion")
    return quaternions.to_matrix(q)


def table_text(columns: Mapping[str, Sequence[str]]) -> str:
    """Columns of text as the text of a CSV file."""
    return csv_text(list(columns), zip(*columns.values(), strict=True))


def numbers(values: np.ndarray) -> list[str]:
    """Shortest decimals that read back as the same bits."""
    return list(map(repr, np.asarray(values).tolist()))
