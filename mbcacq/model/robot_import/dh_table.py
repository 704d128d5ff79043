"""An arm of a table of Denavit-Hartenberg rows, CSV or YAML, in the standard or the modified convention."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model import yaml12
from mbcacq.model.robot_import.source import ArmSource

MAX_BYTES = 1_000_000
FACTORS = {"_deg": np.pi / 180, "_rad": 1.0, "_mm": 1.0, "_m": 1e3}
ANGLES, LENGTHS = ("theta", "alpha"), ("d", "a")
OTHERS = ("lower_deg", "upper_deg", "speed_deg_s", "mass_kg", "com_x_mm", "com_y_mm", "com_z_mm", "joint")


def read_dh_table(path: Path, convention: str) -> ArmSource:
    """convention: 'standard', each row Rz(theta + q) Tz(d) Tx(a) Rx(alpha); or 'modified' (Craig), Rx(alpha) Tx(a) Rz(theta + q) Tz(d).

    Raises ConfigError for a table that lacks a column or a number.
    """
    rows = _rows(path)
    theta, d, a, alpha = (_column(path, rows, name) for name in ("theta", "d", "a", "alpha"))

    def forward(q: np.ndarray) -> np.ndarray:
        return _frames(convention, theta, d, a, alpha, q)[1]

    axes, flange = _frames(convention, theta, d, a, alpha, np.zeros((1, len(rows))))
    lower, upper, speed, mass = (_optional(path, rows, name) for name in ("lower_deg", "upper_deg", "speed_deg_s", "mass_kg"))
    com = np.nan_to_num(np.stack([_optional(path, rows, f"com_{c}_mm") for c in "xyz"], axis=1))
    behind = _links(convention, axes[0], flange[0])
    remarks = ["joint angles are counted from the table's theta: the angles a controller shows must be those of the table's q"]
    return ArmSource(
        name=path.stem,
        base="base",
        flange="flange",
        joints=[str(row.get("joint") or f"A{i + 1}") for i, row in enumerate(rows)],
        direction=axes[0, :, :3, 2],
        point=axes[0, :, :3, 3],
        T_base_flange=flange[0],
        limits=np.radians(np.stack([lower, upper], axis=1)),
        speed=np.radians(speed),
        mass=np.nan_to_num(mass),
        com=se3.apply(behind, com),
        forward=forward,
        remarks=remarks,
    )


def _frames(convention: str, theta: np.ndarray, d: np.ndarray, a: np.ndarray, alpha: np.ndarray, q: np.ndarray) -> tuple[Any, Any]:
    """Frames (P, n, 4, 4) whose z are the joint axes, and the flange (P, 4, 4)."""
    T, axes = np.broadcast_to(np.eye(4), (len(q), 4, 4)), []
    for i in range(len(theta)):
        turn = np.zeros((len(q), 3))
        turn[:, 2] = theta[i] + q[:, i]
        about_z = se3.transform(se3.rotation_exp(turn), np.array([0.0, 0.0, d[i]]))
        about_x = se3.transform(se3.rotation_exp(np.array([alpha[i], 0.0, 0.0])), np.array([a[i], 0.0, 0.0]))
        T = T if convention == "standard" else T @ about_x
        axes.append(T)
        T = T @ about_z @ about_x if convention == "standard" else T @ about_z
    return np.stack(axes, axis=1), T


def _links(convention: str, axes: np.ndarray, flange: np.ndarray) -> np.ndarray:
    """(n, 4, 4): the frames in which the table's convention gives centres of gravity."""
    return axes if convention == "modified" else np.concatenate([axes[1:], flange[None]])


def _rows(path: Path) -> list[dict[str, Any]]:
    try:
        text = path.read_bytes()[: MAX_BYTES + 1].decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: the table cannot be read ({error.strerror}); correct the path") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: the table is not UTF-8 text; save it as UTF-8") from None
    if path.suffix == ".csv":
        separator = ";" if ";" in text.split("\n", 1)[0] else ","
        rows: Any = [{str(k).strip(): v for k, v in row.items()} for row in csv.DictReader(io.StringIO(text), delimiter=separator)]
        if separator == ";":  # a German Excel also writes decimal commas
            rows = [{k: v.replace(",", ".") if isinstance(v, str) else v for k, v in row.items()} for row in rows]
    else:
        try:
            data = yaml12.load(text)
        except yaml.YAMLError as error:
            raise ConfigError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from None
        rows = data.get("rows") if isinstance(data, dict) else data
    if not isinstance(rows, list) or len(rows) < 2 or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(f"{path}: a table of at least two rows with columns theta_deg, d_mm, a_mm, alpha_deg is needed")
    return rows


def _column(path: Path, rows: list[dict[str, Any]], name: str) -> np.ndarray:
    """(n,) rad or mm of a column that is there in one of its units."""
    units = ("_deg", "_rad") if name in ANGLES else ("_mm", "_m")
    for unit in units:
        if name + unit in rows[0]:
            return FACTORS[unit] * np.array([_number(path, i, name + unit, row.get(name + unit)) for i, row in enumerate(rows)])
    known = ", ".join(sorted(map(str, rows[0])))
    raise ConfigError(f"{path}: has no column {name}{units[0]} or {name}{units[1]} (its columns are {known}); the unit is part of the name")


def _optional(path: Path, rows: list[dict[str, Any]], name: str) -> np.ndarray:
    """(n,), nan where a row is silent."""
    return np.array([np.nan if row.get(name) in (None, "") else _number(path, i, name, row[name]) for i, row in enumerate(rows)])


def _number(path: Path, row: int, name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise ConfigError(f"{path}: row {row + 1}: {name} is {value!r}, not a number; correct it")
    return number
