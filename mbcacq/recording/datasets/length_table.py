"""A table of an arm's poses with distances: a draw wire, a ballbar, an interferometer or a laser distance meter, one or several at once.

Each distance is from a point in the base, that of its column, to one point on the flange.
"""

from __future__ import annotations

import re

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import predict
from mbcacq.estimation.initial_guess import start
from mbcacq.files.table import Table
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, RobotModel, Station, arm_of_flange_poses
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.columns import flange_group, groups, joint_angles, joint_columns
from mbcacq.recording.datasets.loose_table import WRONG_ARM_MM, TableOptions, UnderstoodTable, conventions_of, in_units
from mbcacq.recording.datasets.pose_columns import LENGTHS, METRES_BELOW, heading, role

WORDS = {"length", "lengths", "distance", "dist", "range", "wire", "cable", "drawwire", "ballbar", "interferometer", "laser", "encoder"}
SCALE = 1e-4  # relative standard uncertainty of the scale of such an instrument, where nobody says another
POINT = "the point on the flange"


def read_lengths(table: Table, options: TableOptions) -> UnderstoodTable | None:
    """The observations of a table of distances; None where it has none, or has places of a target beside them. Raises ConfigError."""
    found = {name: heading(name).unit for name in length_columns(table)}
    if not found or any(role(group) == "target" for group in groups(table)):
        return None
    robot, q, how = _arm(table, options)
    values = np.stack([table.number(name, empty=np.nan) * _unit(table, name, unit, options) for name, unit in found.items()], axis=1)
    row, wire = np.nonzero(np.isfinite(values))
    length = values[row, wire]
    if (length <= 0).any():
        raise ConfigError(
            f"{table.where(int(row[np.argmin(length)]), list(found)[0])}: a distance of {length.min():g} mm is impossible; correct it"
        )
    zero = np.zeros(len(row))
    target = Artefact("target", POINT, (1,), np.zeros((1, 3)), np.zeros(1), 0.0)
    noise = None if options.noise_mm is None else np.array(options.noise_mm)
    stations = tuple(Station(name, "target") for name in found)
    cell = Cell(robot, np.eye(4), (target,), stations, noise_mm=noise, measurement=TARGET_IN_BASE, length_scale=SCALE)
    count = np.arange(len(row))
    obs = Observations(cell, count + 1, wire, q[row], count, np.zeros(len(row), int), np.stack([length, zero, zero], axis=1))
    missed = (obs.xyz - predict(obs, start(obs)).xyz)[:, 0]
    off = float(np.median(np.abs(missed - np.median(missed))))
    if off > WRONG_ARM_MM:
        raise ConfigError(
            f"{table.path}: {robot.name} explains the distances in {', '.join(found)} within {off:.3g} mm only; check the arm (--robot), "
            "the units, and that angles and distances are of one row"
        )
    said = (
        how,
        f"distances in {', '.join(found)}, each from a point in the base to {POINT}; both, and the instrument's offset, are estimated",
        f"the instrument's scale is right to {1e6 * SCALE:g} ppm (k = 1); length_scale of cell.yaml says another",
        f"{len(row)} distances, which fit within {off:.3g} mm (median)",
    )
    others = [name for name in table.columns if name not in found and name not in table.taken]
    return UnderstoodTable(obs, (*said, *([f"not used: {', '.join(others)}"] if others else [])))


def length_columns(table: Table) -> list[str]:
    """The columns whose names say that they are distances."""
    joints = joint_columns(table)
    return [name for name in table.columns if name not in joints and WORDS & set(re.split(r"[^a-z]+", name.lower().replace("draw", "")))]


def _unit(table: Table, name: str, unit: str, options: TableOptions) -> float:
    """mm of the unit of a column: by its heading, as it was said, or by the size of its numbers."""
    said = LENGTHS.get(unit or options.length or "")
    return said or (1e3 if np.nanmax(np.abs(table.number(name, empty=np.nan))) < METRES_BELOW else 1.0)


def _arm(table: Table, options: TableOptions) -> tuple[RobotModel, np.ndarray, str]:
    """The arm, the coordinates of each row, and in words what they are."""
    if joints := joint_columns(table):
        if options.robot is None or len(joints) != options.robot.n:
            raise ConfigError(f"{table.path}: distances with {len(joints)} joint angles; name the arm that has them: --robot ROBOT")
        return options.robot, joint_angles(table, joints, options.angle), f"joint angles of {options.robot.name}"
    group = flange_group(table)
    if group is None:
        raise ConfigError(f"{table.path}: distances without joint angles or the pose of the flange; add their columns")
    allowed = conventions_of(group, options.flange, "--flange")
    if len(allowed) > 1:
        raise ConfigError(f"{table.path}: {', '.join(group.rotation)} may be {' or '.join(allowed)}; say which it is: --flange")
    q = in_units(group, table, options).coordinates(table)
    return arm_of_flange_poses("arm of flange poses", None, q), q, f"flange: {in_units(group, table, options).described()}"
