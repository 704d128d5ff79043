"""Joint angles as a controller logged them at the poses of a plan: a CSV table, or the data list of a KRL program."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import bytes_of
from mbcacq.files.table import Column, TableSchema, read_table
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.controller_joints import from_controller
from mbcacq.quantities import DEGREE, in_degrees
from mbcacq.recording.datasets.columns_of_joints import schema_of

NEAR = 3.0 * DEGREE  # of a planned pose: a program goes there exactly
MAX_BYTES = 64 << 20
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_AT = re.compile(r"mb_at\[(\d+)\]\s*=\s*\{([^{}]*)\}", re.IGNORECASE)
_TEXT_MESSAGE = re.compile(r"mbcacq joints\s*\[([^\]]*)\]")


@dataclass(frozen=True)
class JointLog:
    """q: number of a pose -> (n,) rad, mm as logged. notes: a sentence for each row that is not used, or says something odd."""

    q: dict[int, np.ndarray]
    notes: list[str] = field(default_factory=list)


def read_joint_log(path: Path, loaded: LoadedPlan, poses: list[PlannedPose]) -> JointLog:
    """The log of the poses that a program went through, ``poses`` being in its order.

    Raises ConfigError naming file and line; also where it is in radians, or of another plan.
    """
    if path.suffix.lower() == ".dat":
        rows, number = _krl(path, loaded.cell.robot.axes)
    elif path.suffix.lower() in (".log", ".txt") and _TEXT_MESSAGE.search(_text(path)):
        rows, number = _messages(path, loaded.cell.robot.n)
    else:
        rows, number = _table(path, loaded.cell.robot)
    q = from_controller(loaded, rows)
    _refuse_radians(path, loaded, q, rows, poses)
    return _paired(path, q, number, poses, loaded.cell.robot.chain)


def _table(path: Path, robot: RobotModel) -> tuple[np.ndarray, list[int] | None]:
    joints = [replace(column, required=True, assumed=column.unit or "") for column in schema_of(robot, "q")]
    table = read_table(path, TableSchema("a log of joints", (Column("pose", kind="integer", required=False), *joints), preamble=True))
    number = [int(v) for v in table.integer("pose")] if table.has("pose") else None
    return table.numbers([column.name for column in joints]), number


def _krl(path: Path, axes: tuple[str, ...]) -> tuple[np.ndarray, None]:
    rows: list[list[float]] = []
    for match in _AT.finditer(_text(path)):
        values = [re.search(rf"\b{axis}\s+({_NUMBER})\s*(?:,|$)", match[2], re.IGNORECASE | re.ASCII) for axis in axes]
        if not all(v is not None and np.isfinite(float(v[1])) for v in values):
            raise ConfigError(f"{path}: mb_at[{match[1]}] has not the angles of {len(axes)} axes; copy the file from the controller anew")
        rows.append([float(v[1]) for v in values if v is not None])
    if not rows:
        raise ConfigError(f"{path}: holds no angles mb_at[..]; give the data list of the program, copied back from the controller")
    return np.array(rows), None


def _messages(path: Path, n: int) -> tuple[np.ndarray, None]:
    rows = [[cell.strip() for cell in match[1].split(",")] for match in _TEXT_MESSAGE.finditer(_text(path))]
    for row in rows:
        if len(row) != n or not all(re.fullmatch(_NUMBER, v, re.ASCII) and np.isfinite(float(v)) for v in row):
            raise ConfigError(f"{path}: a message 'mbcacq joints' lacks {n} numeric angles; save the log anew")
    return in_degrees(np.array(rows, dtype=float)), None


def _text(path: Path) -> str:
    part = "give the part of the log with the joint angles"
    return bytes_of(path, MAX_BYTES, "give the log of the joint angles", part).decode("latin-1")


def _away(q: np.ndarray, poses: list[PlannedPose], chain: Chain) -> np.ndarray:
    """(R, P) rad: largest difference of a joint between each row and each pose; 1 mm of one that slides counts as 1 mrad."""
    planned = np.array([pose.q for pose in poses])
    return np.max(np.abs(q[:, None] - planned[None]) * chain.by_kind(1.0, 1e-3), axis=2)


def _refuse_radians(path: Path, loaded: LoadedPlan, q: np.ndarray, rows: np.ndarray, poses: list[PlannedPose]) -> None:
    in_radians = from_controller(loaded, in_degrees(rows))
    chain = loaded.cell.robot.chain
    if np.median(_away(q, poses, chain).min(axis=1)) > NEAR and np.median(_away(in_radians, poses, chain).min(axis=1)) < NEAR:
        raise ConfigError(f"{path}: its angles are in rad, not in deg; name the columns q1_rad.. or convert them")


def _paired(path: Path, q: np.ndarray, number: list[int] | None, poses: list[PlannedPose], chain: Chain) -> JointLog:
    away, notes, found = _away(q, poses, chain), list[str](), dict[int, np.ndarray]()
    reached = np.any(q != 0, axis=1) & (away.min(axis=1) < NEAR)
    if np.sum(reached) < 0.5 * np.sum(np.any(q != 0, axis=1)):
        raise ConfigError(
            f"{path}: {int(np.sum(~reached))} of {len(q)} rows are at no pose of this plan; is it the log of another plan, or does the "
            "controller count its joints otherwise (robot: controller_joints)?"
        )
    index = {pose.number: k for k, pose in enumerate(poses)}
    position = 0
    for row in range(len(q)):
        if not np.any(q[row]):
            continue  # the data list of a program that was stopped half-way
        if number is not None:
            k = index.get(number[row])
            if k is None:
                notes.append(f"{path.name}: row {row + 1} is of pose {number[row]}, which the plan does not have here; left out")
                continue
        else:
            near = np.flatnonzero(away[row] < NEAR)
            if not len(near):
                notes.append(f"{path.name}: row {row + 1} is at no pose of the plan; left out")
                continue
            later = near[near >= position]
            k = int((later if len(later) else near)[0])
            position = k + 1
        if away[row, k] > NEAR:
            degrees = in_degrees(away[row, k])
            notes.append(f"{path.name}: at pose {poses[k].number} the arm stood {degrees:.2f}° from where the plan has it")
        found[poses[k].number] = q[row]
    return JointLog(found, notes)
