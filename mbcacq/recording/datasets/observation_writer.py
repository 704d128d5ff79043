"""Observations out as a folder of ``cell.yaml``, ``poses.csv`` and ``centres.csv``."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping, Sequence
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import Content, write_files
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees
from mbcacq.recording.datasets import covariances, quaternions
from mbcacq.recording.datasets.cell_yaml import cell_to_yaml, parse_cell
from mbcacq.recording.datasets.columns_of_joints import text_of_joints
from mbcacq.recording.datasets.csv_columns import FLANGE_VELOCITY, QUATERNION, XYZ, numbers, table_text

IMAGES = "images.json"
# A rotation vector in rad: the numbers that are in memory, and a heading that cannot be meant otherwise.
FLANGE_COLUMNS = ("flange_x_mm", "flange_y_mm", "flange_z_mm", "flange_rotvec_x_rad", "flange_rotvec_y_rad", "flange_rotvec_z_rad")


def write_observation_set(observations: Observations, folder: Path | str, scans: Mapping[str, Content] | None = None) -> None:
    """Write the folder (made if absent; its three files are replaced) as one set. Raises RecordingError if that is impossible.

    scans: clouds that belong to it, by their names in the folder.
    """
    obs, folder = observations, Path(folder)
    tables = {"poses.csv": table_text(_pose_columns(obs)), "centres.csv": table_text(_centre_columns(obs))}
    if obs.images is not None:
        tables[IMAGES] = json.dumps(obs.images.to_dict(), indent=1)
    write_files(folder, {"cell.yaml": _cell_text(obs), **tables, **(scans or {})})


def _cell_text(obs: Observations) -> str:
    """The text the cell came from while it still says the same, so that comments and unknown keys survive."""
    fresh = cell_to_yaml(obs.cell)
    if obs.cell_yaml:
        try:
            if cell_to_yaml(parse_cell(obs.cell_yaml)) == fresh:
                return obs.cell_yaml
        except ConfigError:
            pass
    return fresh


def _pose_columns(obs: Observations) -> dict[str, Sequence[str]]:
    station = np.array([s.id for s in obs.cell.stations])
    columns: dict[str, Sequence[str]] = {"pose": numbers(obs.pose_id)}
    if obs.phase is not None:
        columns["phase"] = obs.phase.tolist()
    columns["station"] = station[obs.station].tolist()
    if obs.time_s is not None:
        columns["time_s"] = numbers(obs.time_s)
    if obs.cell.robot.of_flange_poses:
        columns |= dict(zip(FLANGE_COLUMNS, map(numbers, obs.q.T), strict=True))
    else:
        columns |= text_of_joints(obs.cell.robot, "q", obs.q)
    if obs.flange_velocity is not None and obs.sensor_time_s is not None:
        columns["sensor_time_s"] = numbers(obs.sensor_time_s)
        of_flange = np.concatenate([obs.flange_velocity[:, :3].T, in_degrees(obs.flange_velocity[:, 3:]).T])
        columns |= dict(zip(FLANGE_VELOCITY, map(numbers, of_flange), strict=True))
    for quantity, values in (("dir", obs.direction), ("qd", obs.velocity), ("tau", obs.torque), ("i", obs.current)):
        if values is not None:
            columns |= text_of_joints(obs.cell.robot, quantity, values)
    if obs.payload_kg is not None:
        columns["payload_kg"] = numbers(obs.payload_kg)
    columns |= {name: numbers(values) for name, values in obs.temperatures.items()}
    return columns | _extra(obs, "poses.", columns)


def _centre_columns(obs: Observations) -> dict[str, Sequence[str]]:
    ball = np.array(obs.cell.ball_ids)
    columns: dict[str, Sequence[str]] = {"pose": numbers(obs.pose_id[obs.pose]), "ball": numbers(ball[obs.ball])}
    columns |= dict(zip(XYZ, map(numbers, obs.xyz.T), strict=True))
    for name in ("n_points", "rms_mm"):
        if (values := getattr(obs, name)) is not None:
            columns[name] = numbers(values)
    if obs.rotation is not None:
        columns |= _quaternion_columns(obs, obs.rotation)
    if obs.covariance is not None:
        columns |= covariances.columns(obs.covariance)
    if obs.shared is not None:
        columns |= covariances.shared_columns(obs.shared)
    skip = {*columns, *QUATERNION}
    return columns | _extra(obs, "centres.", skip)


def _quaternion_columns(obs: Observations, rotation: np.ndarray) -> dict[str, Sequence[str]]:
    """The text the rotations came from while it still says the same, else their quaternions. rotation: (M, 3, 3)."""
    kept = {name: obs.extra[f"centres.{name}"] for name in QUATERNION if f"centres.{name}" in obs.extra}
    if len(kept) == len(QUATERNION):
        try:
            q = np.stack([cells.astype(float) for cells in kept.values()], axis=1)
        except ValueError:
            q = np.zeros((0, 4))
        if q.shape == (obs.n_centres, 4) and np.array_equal(quaternions.to_matrix(q), rotation):
            return {name: cells.tolist() for name, cells in kept.items()}
    return dict(zip(QUATERNION, map(numbers, quaternions.from_matrix(rotation).T), strict=True))


def _extra(obs: Observations, prefix: str, skip: Container[str]) -> dict[str, Sequence[str]]:
    return {
        name.removeprefix(prefix): cells.tolist()
        for name, cells in obs.extra.items()
        if name.startswith(prefix) and name.removeprefix(prefix) not in skip
    }
