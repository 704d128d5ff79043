"""Columns of the joints of a robot: what they are called, their units, and their numbers inside and in files.

A file has deg, deg/s and N m of a joint that turns, mm, mm/s and N of one that slides. An axis of the arm is q1, an external one e1:
q1_deg, e1_mm; qd1_deg_s, ed1_mm_s; tau1_Nm, etau1_N; dir1, edir1; i1_A, ei1_A. A joint that another one moves has no column: its position
is zero.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.files import angles
from mbcacq.files.table import Column, Table
from mbcacq.files.table_schema import JOINT_NAMES
from mbcacq.model.cell import RobotModel

# Unit of a joint that turns, and of one that slides, by what is given of it; how the name of the column ends.
UNITS = {
    "q": (("deg", "_deg"), ("mm", "_mm")),
    "qd": (("deg/s", "_deg_s"), ("mm/s", "_mm_s")),
    "tau": (("N*m", "_Nm"), ("N", "_N")),
    "motor_tau": (("N*m", "_Nm"), ("N*m", "_Nm")),
    "dir": ((None, ""), (None, "")),
    "i": (("A", "_A"), ("A", "_A")),
    "i_percent": ((None, "_percent"), (None, "_percent")),
}
ANGLES = ("q", "qd")


def stem(axis: str, quantity: str, form: str = "") -> str:
    """Name of a column without its unit: q1 of A1, e1 of E1; form: what stands behind the number, '_set'."""
    quantity = quantity.removesuffix("_percent")
    if axis.startswith("A"):
        return f"{quantity}{axis[1:]}{form}"
    return f"e{quantity.removeprefix('q')}{axis[1:]}{form}"


def headings(robot: RobotModel, quantity: str, form: str = "") -> list[str]:
    """The columns of a quantity, of every axis that is counted."""
    kinds = zip(robot.axes, robot.chain.prismatic.tolist(), robot.counted.tolist(), strict=True)
    return [stem(axis, quantity, form) + UNITS[quantity][slides][1] for axis, slides, counted in kinds if counted]


def schema_of(robot: RobotModel, quantity: str, form: str = "") -> tuple[Column, ...]:
    """The columns as a table's schema has them; positions also by the names that controllers give them."""
    out = []
    for axis, slides, counted in zip(robot.axes, robot.chain.prismatic.tolist(), robot.counted.tolist(), strict=True):
        unit, named = UNITS[quantity][slides][0], quantity == "q" and not form
        own = axis.startswith("A")
        aliases = tuple(a.format(axis[1:]) for a in JOINT_NAMES) if named and own else (axis,) if named else ()
        column = Column(stem(axis, quantity, form), unit, aliases=aliases, required=False, assumed_of_aliases=(unit or "") if named else "")
        out += [column] if counted else []
    return tuple(out)


def read_joints(table: Table, robot: RobotModel, quantity: str, form: str = "") -> np.ndarray | None:
    """(rows, n) rad, mm, N m or N inside; None where no axis has a column, and of an axis without one NaN, or zero where it follows."""
    out = np.where(robot.counted, np.nan, 0.0) * np.ones((len(table), 1))
    names = iter(headings(robot, quantity, form))
    found = False
    for i in np.flatnonzero(robot.counted):
        if table.has(name := next(names)):
            turned = quantity in ANGLES and not robot.chain.prismatic[i]
            out[:, i], found = table.radians(name) if turned else table.number(name), True
    return out if found else None


def text_of_joints(robot: RobotModel, quantity: str, values: np.ndarray, form: str = "") -> dict[str, Sequence[str]]:
    """Columns of values (rows, n) as text that reads back as the same bits; none of an axis that has a value that is not finite."""
    own = [i for i in range(robot.n) if robot.counted[i]]
    turned = quantity in ANGLES
    return {
        name: angles.degrees_text(values[:, i]) if turned and not robot.chain.prismatic[i] else list(map(repr, values[:, i].tolist()))
        for name, i in zip(headings(robot, quantity, form), own, strict=True)
        if np.isfinite(values[:, i]).all()
    }
