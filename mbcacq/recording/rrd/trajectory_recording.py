"""The controller cycles of a run as a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import from_degrees
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.trajectory_set import write_trajectory_set
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import open_recordings

TORQUE, JOINT_SIDE = "GearTorque", "AJPos"  # elements a controller may send: torque about the joints, N m; joint-side encoders, deg


def trajectory_of_run(path: Path | str) -> Trajectory:
    """The controller cycles of a run folder or .rrd as a trajectory, on the controller's clock; cycles reported twice count once."""
    recordings = open_recordings(path)
    columns = [recording.cycles().columns for recording in recordings]
    columns = [c for c in columns if c]
    if not columns:
        raise ConfigError(f"{path} holds no controller cycles; give the recording of a run")
    joined = {name: np.concatenate([c[name] for c in columns]) for name in columns[0] if all(name in c for c in columns)}
    time_s, first = np.unique(joined["time_s"], return_index=True)
    taken = {name: values[first] for name, values in joined.items()}
    cell = parse_cell(recordings[0].text(layout.CELL), f"{path} (its cell description)")
    return Trajectory(
        cell.robot,
        time_s,
        taken["q"],
        q_set=_command(taken),
        q_joint=_joint_side(taken),
        torque=taken.get(TORQUE),
        current=taken.get("current_percent"),
        current_unit="percent",
        name=str(path),
        simulated=cell.simulated,
    )


def _command(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """What the axes were asked for: the path with its corrections, where the driver says it; else the controller's own set point."""
    for name in ("q_command", "q_set"):
        values = columns.get(name)
        if values is not None and np.isfinite(values).all():
            return values
    return None


def _joint_side(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    values = columns.get(JOINT_SIDE)
    return None if values is None else from_degrees(values)


def export_trajectory(path: Path | str, folder: Path | str) -> int:
    """Write the cycles of a run as a trajectory set. Returns the number of samples."""
    trajectory = trajectory_of_run(path)
    write_trajectory_set(trajectory, folder)
    return len(trajectory.time_s)
