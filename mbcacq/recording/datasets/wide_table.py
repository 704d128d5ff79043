"""``poses.csv`` as one wide table: joint angles and what was measured in one row.

One ball or target has the columns x_mm, y_mm, z_mm (and qw, qx, qy, qz). Several balls have x1_mm, y1_mm, z1_mm with the ball's number, and
a row that does not show one of them leaves its cells empty. ``pose`` may be missing (rows are numbered from 1), ``station`` where the cell
has only one, ``ball`` where the cell has only one ball.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.table import Table
from mbcacq.model.cell import Cell
from mbcacq.recording.datasets import covariances
from mbcacq.recording.datasets.columns import by_flange_poses, target_columns
from mbcacq.recording.datasets.csv_columns import QUATERNION, XYZ, rotations
from mbcacq.recording.datasets.pose_columns import PoseHeadings


def wide_centres(table: Table, cell: Cell) -> dict[str, Any] | None:
    """Centre columns of ``Observations`` from the rows of poses.csv, which gets the columns pose and station where it lacks them; None
    where it holds no measured points. Raises ConfigError."""
    several = [ball for ball in cell.ball_ids if table.has(_names(ball))]
    if not several and by_flange_poses(table, cell) and (target := target_columns(table)) is not None:
        return _of_target(table, cell, target)
    if not several and (by_flange_poses(table, cell) or not table.has(XYZ)):
        return None
    if several:
        return _several(table, cell, several)
    rows = np.arange(len(table))
    out: dict[str, Any] = {"pose": rows, "ball": _balls(table, cell), "xyz": table.numbers(XYZ)}
    extra: dict[str, np.ndarray] = {}
    if any(table.has(name) for name in QUATERNION):
        table.require(QUATERNION)
        out["rotation"] = rotations(table)
        extra = {f"centres.{name}": np.array(table.text(name), dtype=np.str_) for name in QUATERNION}
    return out | {"extra": extra}


def _of_target(table: Table, cell: Cell, target: PoseHeadings) -> dict[str, Any]:
    """A target whose pose, or place, stands beside the pose of the flange; a row that does not show it leaves its cells empty."""
    seen = np.array([any(table.columns[name][row].strip() for name in target.names) for row in range(len(table))], dtype=bool)
    part = table.rows(seen)
    T = target.transforms(part)
    table.taken |= set(target.names)
    out: dict[str, Any] = {"pose": np.flatnonzero(seen), "ball": _balls(part, cell), "xyz": T[:, :3, 3]}
    if target.rotation:
        out["rotation"] = T[:, :3, :3]
    if (covariance := covariances.read(part, 6 if target.rotation else 3)) is not None:
        out["covariance"] = covariance
    table.taken |= part.taken
    return out


def _names(ball: int) -> tuple[str, str, str]:
    return f"x{ball}_mm", f"y{ball}_mm", f"z{ball}_mm"


def complete(table: Table, cell: Cell) -> None:
    """Number the rows of a table without poses, and take the only station for all of them. Raises ConfigError if there are several."""
    if not table.has("pose"):
        table.columns["pose"] = tuple(str(i + 1) for i in range(len(table)))
    if not table.has("station"):
        if len(cell.stations) > 1:
            raise ConfigError(f"{table.path}:1: column station is missing, and cell.yaml has {len(cell.stations)} stations; add it")
        table.columns["station"] = tuple(station.id for station in cell.stations) * len(table)


def _balls(table: Table, cell: Cell) -> np.ndarray:
    """(rows,) index of the ball that each row shows."""
    if not table.has("ball"):
        if len(cell.ball_ids) > 1:
            raise ConfigError(f"{table.path}:1: column ball is missing, and cell.yaml has {len(cell.ball_ids)} balls; add it")
        return np.zeros(len(table), dtype=np.int64)
    index = {ball: i for i, ball in enumerate(cell.ball_ids)}
    ids = table.integer("ball").tolist()
    for row, ball in enumerate(ids):
        if ball not in index:
            raise ConfigError(f"{table.where(row, 'ball')}: ball {ball} is on no artefact of cell.yaml; correct it")
    return np.array([index[ball] for ball in ids], dtype=np.int64)


def _several(table: Table, cell: Cell, balls: list[int]) -> dict[str, Any]:
    pose, ball, xyz = [], [], []
    for number in balls:
        names = _names(number)
        seen = np.array([any(map(str.strip, row)) for row in zip(*map(table.text, names), strict=True)], dtype=bool)
        values = table.numbers(names, empty=np.nan)
        half = seen & ~np.isfinite(values).all(axis=1)
        if half.any():
            row = int(np.argmax(half))
            name = names[int(np.argmin(np.isfinite(values[row])))]
            raise ConfigError(f"{table.where(row, name)}: the cell is empty; fill it in, or empty those of the whole ball")
        pose.append(np.flatnonzero(seen))
        ball.append(np.full(int(seen.sum()), cell.ball_ids.index(number)))
        xyz.append(values[seen])
    at = np.concatenate(pose)
    order = np.argsort(at, kind="stable")
    if not len(order):
        raise ConfigError(f"{table.path}:2: no row shows a ball; fill the columns {', '.join(_names(balls[0]))}")
    return {"pose": at[order], "ball": np.concatenate(ball)[order], "xyz": np.concatenate(xyz)[order]}
