"""Which columns of a table are the pose of the flange and which that of the target, and what cell.yaml says of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.stated_unit import stated_unit
from mbcacq.files.table import Table
from mbcacq.model.cell import Cell
from mbcacq.model.yaml_source import LARGE, parse
from mbcacq.recording.datasets.columns_of_joints import headings
from mbcacq.recording.datasets.csv_columns import XYZ
from mbcacq.recording.datasets.pose_columns import (
    ANGLES,
    LENGTHS,
    OPENCV,
    RADIANS_BELOW,
    STATISTICS,
    PoseHeadings,
    heading,
    named_convention,
    pose_groups,
    role,
)

UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
LEAST_AXES = 5  # four numbers q1 .. q4 are a quaternion
_JOINT = re.compile(r"^(q|j|a|theta|joint|axis|achse|actual_q|joint_angle)_?([0-9])(_act|_actual)?$")
_OTHER = re.compile("vel|effort|torque|current|target|command", re.IGNORECASE)
_WORD = re.compile(r"[$A-Za-z]+\d*|\d+")
# Words that traces and scopes write before the axis: $AXIS_ACT.A1, "Actual position A1", ActPos_J1, Istposition Achse 1.
_MEASURED = r"(?:\$?axis_act|actual(?:_position|_angle)?|act_?(?:pos(?:ition)?)?|measured(?:_position)?|ist_?position|position)_"
RTDE_JOINT = "actual_q"


def columns_of(text: str) -> dict[str, str]:
    """What the text of a cell.yaml says under ``columns``: what a file calls a column, and this program's name of it."""
    found = parse(text, Path("cell.yaml"), limits=LARGE).data.get("columns") or {}
    return {str(file): str(ours) for ours, file in found.items()}


def by_flange_poses(table: Table, cell: Cell) -> bool:
    """Whether a table gives no joint angles but the pose of the flange."""
    return not any(table.has(name) for name in headings(cell.robot, "q")) and flange_group(table) is not None


def flange_group(table: Table) -> PoseHeadings | None:
    """The columns of the flange's pose: named so, or the only whole pose without a name."""
    found = [g for g in groups(table) if g.rotation]
    named = [g for g in found if role(g) == "flange"]
    named = [g for g in named if "actual" in g.thing] or named  # beside it a controller records where the arm was sent
    unnamed = [g for g in found if role(g) == "" and (g.thing != OPENCV or len(found) == 1)]
    return next(iter(named or unnamed), None)


def target_columns(table: Table) -> PoseHeadings | None:
    """The columns of the target's pose or place: named so, or the first that is not the flange's."""
    flange = flange_group(table)
    left = [g for g in groups(table) if g != flange] if flange and not table.has([*XYZ, "ball"]) else groups(table)
    named = [g for g in left if role(g) == "target"]
    return next(iter(named or left), None)


def groups(table: Table) -> list[PoseHeadings]:
    """The poses and points of a table. Raises ConfigError for an orientation without an owner, or a matrix that is none."""
    try:
        return [g.upright(table) for g in pose_groups(list(table.columns)) if g.thing not in STATISTICS]
    except ConfigError as error:
        raise error if str(error).startswith(str(table.path)) else ConfigError(f"{table.at_headings}: {error}") from None


def flange_columns(table: Table, cell: Cell, text: str) -> PoseHeadings | None:
    """The columns of the flange's pose with convention and units, those of cell.yaml (its text) first; None where there are joint angles.

    Raises ConfigError where neither joints nor a pose are given, or nothing says how an orientation is meant.
    """
    joints = headings(cell.robot, "q")
    some = any(table.has(name) for name in joints)
    if some and cell.robot.of_flange_poses:
        raise ConfigError(f"{table.path.with_name('cell.yaml')}:1: robot is missing, and poses.csv has joint angles; add the robot's links")
    if some:
        return None
    found = flange_group(table)
    if found is None or not table.has(["pose", "station"]):
        table.require([n for n in ("pose", "station", *joints) if found is None or n not in joints])
    if found is None:
        raise ConfigError(
            f"{table.path}:1: column {', '.join(joints)} is missing (the header has: {', '.join(table.columns)}); add the joint angles, or "
            "the pose of the flange: x_mm, y_mm, z_mm and a_deg, b_deg, c_deg (KUKA), w_deg, p_deg, r_deg (FANUC), rx_rad, ry_rad, rz_rad "
            "(UR) or qw, qx, qy, qz"
        )
    table.expect_decimals([name for group in groups(table) for name in group.names])
    said = parse(text, Path("cell.yaml"), limits=LARGE).data.get("flange_poses") or {}
    if said.get("orientation"):
        where = f"{table.path.with_name('cell.yaml')}: flange_poses: orientation"
        found = replace(found, convention=named_convention(said["orientation"], where), alternatives=())
    found = replace(
        found, length=found.length or LENGTHS.get(said.get("length", "")), angle=found.angle or ANGLES.get(said.get("angle", ""))
    )
    found = found.with_units(table)
    if found.alternatives and found.convention != "ZYX":
        names = ", ".join(found.rotation)
        raise ConfigError(
            f"{table.path}:1: column {names} may be a rotation vector (UR) or angles of several orders; say which in cell.yaml, "
            f"flange_poses: {{orientation: ur}} (or yaskawa, staubli, ZYX ..), or let mbcacq data new try them on the data"
        )
    return found


def joint_columns(table: Table) -> list[str]:
    """The columns of joint angles in the order of the axes: q1_deg .., J1 .., A1 .., joint_1 .., axis 1 .., actual_q_0 ..; [] where there
    are none."""
    return _ros_joints(table) or joints_among(list(table.columns))


def _ros_joints(table: Table) -> list[str]:
    """The angles of a text log of ROS (field.position0 ..) in the order of the axes, by the names in field.name0 ..: numbers in them, or
    those of a Universal Robot. [] where there are none, or the names do not say."""
    at = [m[1] for name in table.columns if (m := re.fullmatch(r"field\.position(\d+)", name)) and f"field.name{m[1]}" in table.columns]
    names = [set(table.columns[f"field.name{i}"]) for i in at]
    if len(at) < LEAST_AXES or any(len(of) != 1 for of in names):
        return []
    said = [next(iter(of)) for of in names]
    order = [next((k for k, word in enumerate(UR_JOINTS) if word in name), None) for name in said]
    if None in order:
        order = [int(m[1]) if (m := re.search(r"(\d+)$", name)) else None for name in said]
    if None in order or len(set(order)) < len(order):
        return []
    return [f"field.position{i}" for _, i in sorted(zip(order, at, strict=True), key=lambda pair: pair[0] or 0)]


def joint_angles(table: Table, joints: Sequence[str], said: str | None = None) -> np.ndarray:
    """(rows, n) rad of columns of joint angles, in the unit that was said, that of the headings, rad of UR's actual_q, or by the size."""
    unit = said or next((heading(name).unit for name in joints if heading(name).unit in ANGLES), None)
    if unit is None and all(name.strip().lower().startswith((RTDE_JOINT, "field.")) for name in joints):
        unit = "rad"
    if unit is None:
        unit = "rad" if np.abs(table.numbers(joints)).max(initial=0.0) < RADIANS_BELOW else "deg"
    in_deg = ANGLES[unit] == ANGLES["deg"]
    return table.numbers(joints, angle=True) if in_deg else table.numbers(joints)


def names_poses(headings: Sequence[str]) -> bool:
    """Whether a line of a file is the headings of joint angles, or of poses or points."""
    try:
        return bool(pose_groups(headings) or joints_among(headings))
    except ConfigError:
        return True  # understood well enough to be refused with its reason


def unit_above(table: Table) -> str | None:
    """The unit of length that lines above the headings state (``Units: mm``), None without any. Raises ConfigError for an unknown one."""
    unit = stated_unit("\n".join(table.preamble), str(table.path))
    if unit and unit not in LENGTHS:
        raise ConfigError(f"{table.path}: the unit '{unit}' above the headings is none that is read; give mm, cm, m, um or inch")
    return unit or None


def joints_among(headings: Sequence[str]) -> list[str]:
    found = _numbered_joints(headings, "") or _numbered_joints(headings, _MEASURED)
    n = len(found)
    first = min(found, default=1)  # RTDE counts from 0
    if n >= LEAST_AXES and sorted(found) == list(range(first, n + first)):
        return [found[i + first] for i in range(n)]
    named = [[name for name in headings if word in name.lower() and not _OTHER.search(name)] for word in UR_JOINTS]
    return [name for (name,) in named] if all(len(names) == 1 for names in named) else []


def _numbered_joints(headings: Sequence[str], before: str) -> dict[int, str]:
    """Number -> heading of the columns of joints whose names stand behind ``before``, a pattern; the first of two alike."""
    found: dict[int, str] = {}
    for name in headings:
        words = "_".join(w.lower() for w in _WORD.findall(heading_text(name)))
        m = re.match(before, words) if before else None
        bare = words[m.end() :] if m else ("" if before else _whole(name))
        number = _JOINT.match(bare)
        if number and int(number[2]) not in found:
            found[int(number[2])] = name
    return found


def heading_text(name: str) -> str:
    """A heading without a unit in brackets at its end."""
    return re.sub(r"\s*[\[(][^\])\d]*[\])]\s*$", "", name)


def _whole(name: str) -> str:
    part = heading(name)
    return "_".join(filter(None, (part.thing, part.component)))
