"""Trajectory sets: folders of ``cell.yaml`` and ``trajectory.csv``, as ``Trajectory`` and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict, Field

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set, write_files
from mbcacq.files.table import read_table
from mbcacq.model.bounds import Direction, GearRatio, Repeatability
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import LinkSpec, PayloadSpec, RobotSpec, Strict
from mbcacq.model.shipped import robot_file
from mbcacq.model.trajectory import Trajectory
from mbcacq.model.yaml_source import LARGE, read
from mbcacq.recording.datasets.bag import bag_of, trajectory_columns
from mbcacq.recording.datasets.cell_yaml import robot_to_yaml
from mbcacq.recording.datasets.columns_of_joints import headings, read_joints, text_of_joints
from mbcacq.recording.datasets.csv_columns import numbers, refuse_radians, table_text, trajectory_schema
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
    table = read_table(folder / "trajectory.csv", trajectory_schema(robot))
    table.require(["time_s", *headings(robot, "q")])
    unit = "percent" if table.has("i1_percent") and not table.has("i1_A") else "A"
    time_s = table.time("time_s")
    if len(time_s) > 1 and (np.diff(time_s) <= 0).any():
        row = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise ConfigError(f"{table.where(row, 'time_s')}: the time does not rise; sort the rows and remove doubles")
    q = read_joints(table, robot, "q")
    assert q is not None, "required"
    if not robot.chain.sliding:
        refuse_radians(table, table.numbers(headings(robot, "q")))
    signals = {
        "q_set": read_joints(table, robot, "q", "_set"),
        "q_joint": read_joints(table, robot, "q", "_joint"),
        "torque": read_joints(table, robot, "tau"),
        "motor_torque": read_joints(table, robot, "motor_tau"),
        "current": read_joints(table, robot, "i" if unit == "A" else "i_percent"),
    }
    temperatures = {name: table.number(name) for name in table.columns if name.endswith("_C") and name not in table.taken}
    return Trajectory(
        robot, time_s, q, **signals, current_unit=unit, temperatures=temperatures, extra=table.rest(), name=str(folder), simulated=simulated
    )


def write_trajectory_set(trajectory: Trajectory, folder: Path | str) -> None:
    """Write the folder. Raises RecordingError if that is impossible."""
    t, folder = trajectory, Path(folder)
    columns = {"time_s": numbers(t.time_s)}
    for quantity, values, form in (
        ("q", t.q_set, "_set"),
        ("q", t.q, ""),
        ("q", t.q_joint, "_joint"),
        ("tau", t.torque, ""),
        ("motor_tau", t.motor_torque, ""),
        ("i" if t.current_unit == "A" else "i_percent", t.current, ""),
    ):
        if values is not None:
            columns |= text_of_joints(t.robot, quantity, values, form)
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
