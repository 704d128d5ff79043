"""Where the arm stood when clouds were taken: joint angles or poses of the flange, typed or in a table with a row for each cloud."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.result_io import of_flange_poses
from mbcacq.errors import ConfigError
from mbcacq.files.table import Table, read_table
from mbcacq.geometry import orientations, se3
from mbcacq.geometry.flange_poses import flange_coordinates
from mbcacq.plan.controller_joints import of_the_model
from mbcacq.plan.plausibility import looks_like_radians
from mbcacq.quantities import from_degrees, in_degrees
from mbcacq.recording.datasets.columns import flange_group, joint_angles, joint_columns, names_poses
from mbcacq.recording.datasets.loose_table import TableOptions, directed, in_units
from mbcacq.recording.datasets.pose_columns import named_convention

MAKERS = "kuka, fanuc, abb, ur, yaskawa, staubli or others, or axes such as ZYX"


@dataclass(frozen=True)
class ArmPosition:
    """q: (n,) rad of the joints, or with ``flange`` (6,) mm and rotation vector in rad of the flange's pose."""

    q: np.ndarray
    flange: bool = False


def typed_joints(text: str, result: Mapping[str, Any]) -> ArmPosition:
    """Joint angles in deg with commas, of the arm of a result. Raises ConfigError, also for angles that look like radians."""
    angles_deg = _numbers(text, "--joints", "give degrees with commas, such as 0,-90,90,0,30,0")
    limits = result["robot"].get("limits")
    if limits and (sentence := looks_like_radians(angles_deg, np.array(limits, dtype=float))):
        raise ConfigError(f"--joints: {sentence}")
    return ArmPosition(_of_the_model(np.array(angles_deg), result, "--joints"))


def _of_the_model(positions: np.ndarray, result: Mapping[str, Any], where: str) -> np.ndarray:
    """(..., n) rad, mm of the arm of a result, of positions (..., n) deg, mm as its controller shows them. Raises ConfigError."""
    n = len(result["robot"]["sign"])
    if positions.shape[-1] != n:
        raise ConfigError(f"{where} has {positions.shape[-1]} positions for an arm of {n} axes; give one an axis")
    prismatic = np.isin(np.arange(n), result["robot"].get("sliding", ()))
    counted = result.get("controller_joints", {"matrix": np.eye(n), "offset_deg": np.zeros(n)})
    return of_the_model(positions, np.array(counted["matrix"]), np.array(counted["offset_deg"]), prismatic)


def typed_flange(text: str, orientation: str | None) -> ArmPosition:
    """X, Y, Z in mm and the numbers of an orientation: deg, rad of a rotation vector, or a quaternion. Raises ConfigError."""
    if orientation is None:
        raise ConfigError(f"--flange needs the convention of the orientation, --orientation: {MAKERS}")
    convention = named_convention(orientation, "--orientation")
    values = np.array(_numbers(text, "--flange", "give X,Y,Z in mm and the orientation, with commas"))
    if len(values) != 3 + orientations.size(convention):
        raise ConfigError(
            f"--flange has {len(values)} numbers; X, Y, Z and an orientation as {orientations.in_words(convention)} are "
            f"{3 + orientations.size(convention)}"
        )
    turns = values[3:] if convention in ("vector", "matrix", *orientations.QUATERNIONS) else from_degrees(values[3:])
    try:
        T = se3.transform(orientations.to_matrices(turns[None], convention), values[None, :3])
    except ValueError as error:
        raise ConfigError(f"--flange: {error}; correct it, or --orientation") from None
    return ArmPosition(flange_coordinates(T)[0], flange=True)


def _numbers(text: str, option: str, cure: str) -> list[float]:
    try:
        return [float(part) for part in text.replace(";", ",").split(",")]
    except ValueError:
        raise ConfigError(f"{option} '{text}' is not a list of numbers; {cure}") from None


def positions_in(path: Path, result: Mapping[str, Any], clouds: Sequence[Path], orientation: str | None) -> tuple[list[ArmPosition], str]:
    """The position of the arm at each cloud, by a table of joint angles or poses of the flange, and a sentence on how rows were matched.

    A column that holds the names of the clouds matches them; without one, rows and clouds are in the same order. Raises ConfigError where
    a cloud has no row, or the table leaves the orientation open.
    """
    table = read_table(path, headings=names_poses)
    joints = [] if of_flange_poses(result) else joint_columns(table)
    if joints:
        shown = in_degrees(joint_angles(table, joints))
        found = [ArmPosition(q) for q in _of_the_model(shown, result, table.at_headings)]
    else:
        found = [ArmPosition(q, flange=True) for q in flange_coordinates(_flange(table, orientation))]
    rows, sentence = _rows_of(clouds, table)
    return [found[row] for row in rows], sentence


def _flange(table: Table, orientation: str | None) -> np.ndarray:
    """T_base_flange (rows, 4, 4) mm."""
    group = flange_group(table)
    if group is None:
        raise ConfigError(f"{table.at_headings}: no columns give the pose of the flange (the header has: {', '.join(table.columns)})")
    group = directed(group, None, table, "flange")
    if orientation is None and group.alternatives:
        raise ConfigError(f"{table.at_headings}: the headings leave the convention of the orientation open; say --orientation: {MAKERS}")
    convention = group.convention if orientation is None else named_convention(orientation, "--orientation")
    return in_units(replace(group, convention=convention, alternatives=()), table, TableOptions()).transforms(table)


def _rows_of(clouds: Sequence[Path], table: Table) -> tuple[list[int], str]:
    """The row of each cloud."""
    for heading, cells in table.columns.items():
        row = {Path(cell.strip()).name: k for k, cell in enumerate(cells)}
        row |= {Path(name).stem: k for name, k in row.items()}
        if any(cloud.name in row or cloud.stem in row for cloud in clouds):
            if missing := [c.name for c in clouds if c.name not in row and c.stem not in row]:
                raise ConfigError(
                    f"{table.path}: column {heading} has no row for {', '.join(missing[:3])}; add it, or leave that cloud out"
                )
            return [row[c.name] if c.name in row else row[c.stem] for c in clouds], f"rows are matched by the names in column {heading}"
    if len(clouds) != len(table):
        raise ConfigError(
            f"{table.path} has {len(table)} rows for {len(clouds)} clouds and no column with their names; add one with the file of each"
        )
    return list(range(len(clouds))), f"rows and clouds are taken in the same order, {clouds[0].name} to {clouds[-1].name}"


def clouds_in(folder: Path, endings: Sequence[str]) -> list[Path]:
    """The clouds of a folder in the order of the numbers in their names. Raises ConfigError if there are none."""
    found = [path for path in folder.iterdir() if path.suffix.lower() in endings]
    if not found:
        raise ConfigError(f"{folder} holds no cloud ({', '.join(endings)}); give another folder")
    return sorted(found, key=lambda path: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)])
