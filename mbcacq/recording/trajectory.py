"""Trajectory sets: recordings in time (a run's controller cycles, or another logger's) as arrays, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict, Field

from mbcacq.cell import RobotModel
from mbcacq.cellfile import LinkSpec, PayloadSpec, RobotSpec, Strict, Vector
from mbcacq.errors import ConfigError
from mbcacq.library import robot_file
from mbcacq.recording import angles, layout
from mbcacq.recording.cell_yaml import parse_cell, robot_to_yaml
from mbcacq.recording.csvfile import Table, numbers, read_table, write_table, write_text
from mbcacq.recording.yaml_text import load_yaml, read_yaml_text, validate

FORMAT = "mbcacq-trajectory-set/1"
MOVING_RAD_S, MARGIN_S = 2e-3, 0.25   # an axis moves; what is kept before and after
SHORTEST = 250                        # samples of a move worth keeping
TORQUE, JOINT_SIDE = "GearTorque", "AJPos"   # elements a controller may send: torque about the joints, N m; joint-side encoders, deg


@dataclass(frozen=True)
class Trajectory:
    """T samples of an n-axis arm in time; a signal the recording lacks is None, a joint that lacks it is a column of NaN.

    time_s: (T,). q: (T, n) rad, motor side, as the controller reports it; q_set: (T, n) rad, commanded; q_joint: (T, n) rad, joint-side
    encoder; torque: (T, n) N m about the joint; motor_torque: (T, n) N m at the motor; current: (T, n) in ``current_unit`` ('A' or
    'percent'); temperatures: column (ends in _C) -> (T,). extra: unknown columns as text. name: where it came from.
    """

    robot: RobotModel
    time_s: np.ndarray
    q: np.ndarray
    q_set: np.ndarray | None = None
    q_joint: np.ndarray | None = None
    torque: np.ndarray | None = None
    motor_torque: np.ndarray | None = None
    current: np.ndarray | None = None
    current_unit: str = "A"
    temperatures: Mapping[str, np.ndarray] = field(default_factory=dict)
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    name: str = ""


class _RobotUse(Strict):
    """A robot by its links, or by the name of one of the tool's with what is different about it."""

    name: str = ""
    model: str | None = None
    links: tuple[LinkSpec, ...] | None = Field(default=None, min_length=2)
    gear_ratio: tuple[float, ...] | None = None
    payload: PayloadSpec | None = None
    base_to_gravity: Vector | None = None
    repeatability_mm: float | None = None


class _TrajectorySpec(Strict):
    model_config = ConfigDict(extra="ignore")

    format: Literal["mbcacq-trajectory-set/1"]
    robot: _RobotUse


def is_trajectory_set(folder: Path | str) -> bool:
    """Whether a folder says of itself that it is one."""
    folder = Path(folder)
    return (folder / "cell.yaml").is_file() and (folder / "trajectory.csv").is_file()


def read_trajectory_set(folder: Path | str) -> Trajectory:
    """Read a folder of ``cell.yaml`` and ``trajectory.csv``. Raises ConfigError naming file, line and column of the first fault."""
    folder = Path(folder)
    path = folder / "cell.yaml"
    data, node = load_yaml(read_yaml_text(path), str(path))
    robot = _robot(validate(_TrajectorySpec, data, node, str(path)).robot, str(path))
    table = read_table(folder / "trajectory.csv")
    table.require(["time_s", *(f"q{i + 1}_deg" for i in range(robot.n))])
    unit = "percent" if "i1_percent" in table.columns and "i1_A" not in table.columns else "A"
    time_s = table.number("time_s")
    if len(time_s) > 1 and (np.diff(time_s) <= 0).any():
        row = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise ConfigError(f"{table.where(row, 'time_s')}: the time does not rise; sort the rows and remove doubles")
    signals = {
        "q": _signal(table, "q{}_deg", robot.n, angle=True), "q_set": _signal(table, "q{}_set_deg", robot.n, angle=True),
        "q_joint": _signal(table, "q{}_joint_deg", robot.n, angle=True), "torque": _signal(table, "tau{}_Nm", robot.n),
        "motor_torque": _signal(table, "motor_tau{}_Nm", robot.n), "current": _signal(table, f"i{{}}_{unit}", robot.n),
    }
    temperatures = {name: table.number(name) for name in table.columns if name.endswith("_C")}
    return Trajectory(robot, time_s, **signals, current_unit=unit, temperatures=temperatures, extra=table.rest(), name=str(folder))


def write_trajectory_set(trajectory: Trajectory, folder: Path | str) -> None:
    """Write the folder. Raises RecordingError if that is impossible."""
    t, folder = trajectory, Path(folder)
    write_text(folder / "cell.yaml", robot_to_yaml(FORMAT, t.robot))
    columns = {"time_s": numbers(t.time_s)}
    for pattern, values, text in (
        ("q{}_set_deg", t.q_set, angles.degrees_text), ("q{}_deg", t.q, angles.degrees_text),
        ("q{}_joint_deg", t.q_joint, angles.degrees_text), ("tau{}_Nm", t.torque, numbers),
        ("motor_tau{}_Nm", t.motor_torque, numbers), (f"i{{}}_{t.current_unit}", t.current, numbers),
    ):
        if values is not None:
            columns |= {pattern.format(i + 1): text(column) for i, column in enumerate(values.T) if np.isfinite(column).all()}
    columns |= {name: numbers(values) for name, values in t.temperatures.items()}
    columns |= {name: cells.tolist() for name, cells in t.extra.items() if name not in columns}
    write_table(folder / "trajectory.csv", columns)


def trajectory_of_run(path: Path | str) -> Trajectory:
    """The controller cycles of a run folder or .rrd as a trajectory, on the controller's clock; cycles told twice count once."""
    from mbcacq.recording.reader import open_recordings

    recordings = open_recordings(path)
    columns = [recording.cycles().columns for recording in recordings]
    columns = [c for c in columns if c]
    if not columns:
        raise ConfigError(f"{path} holds no controller cycles; give the recording of a run")
    joined = {name: np.concatenate([c[name] for c in columns]) for name in columns[0] if all(name in c for c in columns)}
    time_s, first = np.unique(joined["time_s"], return_index=True)
    taken = {name: values[first] for name, values in joined.items()}
    robot = parse_cell(recordings[0].text(layout.CELL), f"{path} (its cell description)").robot
    return Trajectory(robot, time_s, taken["q"], q_set=_command(taken), q_joint=_joint_side(taken), torque=taken.get(TORQUE),
                      current=taken.get("current_percent"), current_unit="percent", name=str(path))


def _command(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """What the axes were asked for: the path with its corrections, where the driver says it; else the controller's own set point."""
    for name in ("q_command", "q_set"):
        values = columns.get(name)
        if values is not None and np.isfinite(values).all():
            return values
    return None


def _joint_side(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    values = columns.get(JOINT_SIDE)
    return None if values is None else np.radians(values)


def moves(trajectory: Trajectory, samples: int = 15000) -> list[Trajectory]:
    """The stretches in which the arm moves, with what is before and after, each from rest to rest; of a long recording so many, evenly
    chosen, that about ``samples`` remain. A recording without rest is one stretch."""
    t = trajectory
    step = float(np.median(np.diff(t.time_s)))
    speed = np.abs(np.gradient(t.q, t.time_s, axis=0)).max(axis=1)
    margin = int(MARGIN_S / step)
    near = np.convolve(speed > MOVING_RAD_S, np.ones(2 * margin + 1), mode="same") > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    found = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= SHORTEST]
    total = sum(s.stop - s.start for s in found)
    if total > samples:
        keep = np.unique(np.linspace(0, len(found) - 1, max(int(len(found) * samples / total), 1)).astype(int))
        found = [found[i] for i in keep]
    return [_part(t, s) for s in found]


def _part(t: Trajectory, where: slice) -> Trajectory:
    signals = {name: None if getattr(t, name) is None else getattr(t, name)[where]
               for name in ("q", "q_set", "q_joint", "torque", "motor_torque", "current")}
    return replace(t, time_s=t.time_s[where], **signals, temperatures={k: v[where] for k, v in t.temperatures.items()},
                   extra={k: v[where] for k, v in t.extra.items()})


def export_trajectory(path: Path | str, folder: Path | str) -> int:
    """Write the cycles of a run as a trajectory set. Returns the number of samples."""
    trajectory = trajectory_of_run(path)
    write_trajectory_set(trajectory, folder)
    return len(trajectory.time_s)


def _robot(use: _RobotUse, file: str) -> RobotModel:
    if (use.model is None) == (use.links is None):
        raise ConfigError(f"{file}: robot: give either its links or the model: of one of the tool's robots")
    if use.links is not None:
        links = use.links
        robot = RobotSpec(name=use.name, links=links, payload=use.payload or PayloadSpec(),
                          base_to_gravity=use.base_to_gravity or (0.0, 0.0, -1.0), repeatability_mm=use.repeatability_mm).model()
    else:
        path = robot_file(use.model)
        data, node = load_yaml(read_yaml_text(path), str(path))
        changes = {"name": use.name or None, "payload": use.payload, "base_to_gravity": use.base_to_gravity,
                   "repeatability_mm": use.repeatability_mm}
        robot = validate(RobotSpec, data, node, str(path)).model_copy(update={k: v for k, v in changes.items() if v is not None}).model()
    if use.gear_ratio is None:
        return robot
    if len(use.gear_ratio) != robot.n:
        raise ConfigError(f"{file}: robot: gear_ratio has {len(use.gear_ratio)} numbers, the robot {robot.n} axes; give one for each axis")
    return replace(robot, gear_ratio=np.array(use.gear_ratio))


def _signal(table: Table, pattern: str, n: int, *, angle: bool = False) -> np.ndarray | None:
    """(T, n) with NaN for joints that have no such column; None where no joint has one."""
    names = [pattern.format(i + 1) for i in range(n)]
    if not any(name in table.columns for name in names):
        return None
    out = np.full((len(table), n), np.nan)
    for i, name in enumerate(names):
        if name in table.columns:
            out[:, i] = table.radians(name) if angle else table.number(name)
    return out
