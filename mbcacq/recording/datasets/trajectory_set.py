"""Trajectory sets: folders of ``cell.yaml`` and ``trajectory.csv``, as ``Trajectory`` and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict, Field

from mbcacq.errors import ConfigError
from mbcacq.files import angles
from mbcacq.files.atomic_write import finish_set, write_files
from mbcacq.files.table import Table, read_table
from mbcacq.model.bounds import Direction, GearRatio, Repeatability
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import LinkSpec, PayloadSpec, RobotSpec, Strict
from mbcacq.model.shipped import robot_file
from mbcacq.model.trajectory import Trajectory
from mbcacq.model.yaml_source import LARGE, read
from mbcacq.recording.datasets.bag import bag_of, trajectory_columns
from mbcacq.recording.datasets.cell_yaml import robot_to_yaml
from mbcacq.recording.datasets.csv_columns import numbered, numbers, refuse_radians, table_text, trajectory_schema
from mbcacq.recording.datasets.open_format import validate

FORMAT = "mbcacq-trajectory-set/1"


class _RobotUse(Strict):
    """A robot by its links, or by the name of one of the tool's with what is different about it."""

    name: str = ""
    model: str | None = None
    links: tuple[LinkSpec, ...] | None = Field(default=None, min_length=2)
    gear_ratio: tuple[GearRatio, ...] | None = None
    payload: PayloadSpec | None = None
    base_to_gravity: Direction | None = None
    repeatability_mm: Repeatability | None = None


class _TrajectorySpec(Strict):
    model_config = ConfigDict(extra="ignore")

    format: Literal["mbcacq-trajectory-set/1"]
    simulated: bool = False
    robot: _RobotUse


def is_trajectory_set(folder: Path | str) -> bool:
    """Whether a folder has the files of a trajectory set: cell.yaml and trajectory.csv, or a cell.yaml of that format that names a bag."""
    folder = Path(folder)
    if not (folder / "cell.yaml").is_file():
        return False
    if (folder / "trajectory.csv").is_file():
        return True
    text = read(folder / "cell.yaml", limits=LARGE).text
    return FORMAT in text and bag_of(text, folder) is not None


def read_trajectory_set(folder: Path | str) -> Trajectory:
    """Read a folder of ``cell.yaml`` and ``trajectory.csv``. Raises ConfigError naming file, line and column of the first fault."""
    folder = Path(folder)
    finish_set(folder)
    path = folder / "cell.yaml"
    file = read(path, "description of trajectories", LARGE)
    spec = validate(_TrajectorySpec, file)
    robot = _robot(spec.robot, str(path))
    bag = None if (folder / "trajectory.csv").exists() else bag_of(file.text, folder)
    if bag is not None:
        return Trajectory(robot, **trajectory_columns(folder, bag, robot.n), name=str(folder), simulated=spec.simulated)
    return read_motion(folder, robot, spec.simulated)


def read_motion(folder: Path, robot: RobotModel, simulated: bool) -> Trajectory:
    """``trajectory.csv`` of a folder. Raises ConfigError as ``read_trajectory_set``."""
    table = read_table(folder / "trajectory.csv", trajectory_schema(robot.n))
    table.require(["time_s", *numbered("q{}_deg", robot.n)])
    unit = "percent" if table.has("i1_percent") and not table.has("i1_A") else "A"
    time_s = table.time("time_s")
    if len(time_s) > 1 and (np.diff(time_s) <= 0).any():
        row = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise ConfigError(f"{table.where(row, 'time_s')}: the time does not rise; sort the rows and remove doubles")
    q = table.group(numbered("q{}_deg", robot.n), angle=True)
    refuse_radians(table, table.group(numbered("q{}_deg", robot.n)))
    signals = {
        "q_set": _signal(table, "q{}_set_deg", robot.n, angle=True),
        "q_joint": _signal(table, "q{}_joint_deg", robot.n, angle=True),
        "torque": _signal(table, "tau{}_Nm", robot.n),
        "motor_torque": _signal(table, "motor_tau{}_Nm", robot.n),
        "current": _signal(table, f"i{{}}_{unit}", robot.n),
    }
    temperatures = {name: table.number(name) for name in table.columns if name.endswith("_C") and name not in table.taken}
    return Trajectory(
        robot, time_s, q, **signals, current_unit=unit, temperatures=temperatures, extra=table.rest(), name=str(folder), simulated=simulated
    )


def write_trajectory_set(trajectory: Trajectory, folder: Path | str) -> None:
    """Write the folder. Raises RecordingError if that is impossible."""
    t, folder = trajectory, Path(folder)
    columns = {"time_s": numbers(t.time_s)}
    for pattern, values, text in (
        ("q{}_set_deg", t.q_set, angles.degrees_text),
        ("q{}_deg", t.q, angles.degrees_text),
        ("q{}_joint_deg", t.q_joint, angles.degrees_text),
        ("tau{}_Nm", t.torque, numbers),
        ("motor_tau{}_Nm", t.motor_torque, numbers),
        (f"i{{}}_{t.current_unit}", t.current, numbers),
    ):
        if values is not None:
            columns |= {pattern.format(i + 1): text(column) for i, column in enumerate(values.T) if np.isfinite(column).all()}
    columns |= {name: numbers(values) for name, values in t.temperatures.items()}
    columns |= {name: cells.tolist() for name, cells in t.extra.items() if name not in columns}
    write_files(folder, {"cell.yaml": robot_to_yaml(FORMAT, t.robot, t.simulated), "trajectory.csv": table_text(columns)})


def _robot(use: _RobotUse, file: str) -> RobotModel:
    if use.links is not None and use.model is None:
        robot = RobotSpec(
            name=use.name,
            links=use.links,
            payload=use.payload or PayloadSpec(),
            base_to_gravity=use.base_to_gravity or (0.0, 0.0, -1.0),
            repeatability_mm=use.repeatability_mm,
        ).model()
    elif use.model is not None and use.links is None:
        robot = _shipped_robot(use.model, use)
    else:
        raise ConfigError(f"{file}: robot: give either its links or the model: of one of the tool's robots")
    if use.gear_ratio is None:
        return robot
    if len(use.gear_ratio) != robot.n:
        raise ConfigError(f"{file}: robot: gear_ratio has {len(use.gear_ratio)} numbers, the robot {robot.n} axes; give one for each axis")
    return replace(robot, gear_ratio=np.array(use.gear_ratio))


def _shipped_robot(model: str, use: _RobotUse) -> RobotModel:
    file = read(robot_file(model), "robot file")
    changes = {
        "name": use.name or None,
        "payload": use.payload,
        "base_to_gravity": use.base_to_gravity,
        "repeatability_mm": use.repeatability_mm,
    }
    return validate(RobotSpec, file).model_copy(update={k: v for k, v in changes.items() if v is not None}).model()


def _signal(table: Table, pattern: str, n: int, *, angle: bool = False) -> np.ndarray | None:
    """(T, n) with NaN for joints that have no such column; None where no joint has one."""
    names = [pattern.format(i + 1) for i in range(n)]
    if not any(table.has(name) for name in names):
        return None
    out = np.full((len(table), n), np.nan)
    for i, name in enumerate(names):
        if table.has(name):
            out[:, i] = table.radians(name) if angle else table.number(name)
    return out
