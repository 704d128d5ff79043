"""An arm of a table of Denavit-Hartenberg rows, CSV or YAML, in the standard or the modified convention."""

from __future__ import annotations

import codecs
import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model import yaml12
from mbcacq.model.heading_units import UnknownUnitError, converted, split_heading
from mbcacq.model.robot_import.source import ArmSource

MAX_BYTES = 1_000_000
ANGLES, LENGTHS = ("theta", "alpha"), ("d", "a")
OTHERS = ("lower_deg", "upper_deg", "speed_deg_s", "mass_kg", "com_x_mm", "com_y_mm", "com_z_mm", "joint", "type", "kind")
GREEK = {"θ": "theta", "α": "alpha"}
SHORTEST_ARM_MM, LONGEST_ARM_MM = 20.0, 50e3
_PI = re.compile(r"([-+]?)\s*(\d+(?:\.\d+)?)?\s*\*?\s*(?:pi|π)\s*(?:/\s*(\d+(?:\.\d+)?))?", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


def read_dh_table(path: Path, convention: str) -> ArmSource:
    """convention: 'standard', each row Rz(theta + q) Tz(d) Tx(a) Rx(alpha); or 'modified' (Craig), Rx(alpha) Tx(a) Rz(theta + q) Tz(d).

    Raises ConfigError for a table that lacks a column or a number.
    """
    table = _table(path)
    rows = table.rows
    _refuse_prismatic(path, table)
    theta, d, a, alpha = (_column(path, table, name) for name in ("theta", "d", "a", "alpha"))
    _refuse_other_units(path, table)

    def forward(q: np.ndarray) -> np.ndarray:
        return _frames(convention, theta, d, a, alpha, q)[1]

    axes, flange = _frames(convention, theta, d, a, alpha, np.zeros((1, len(rows))))
    lower, upper, speed, mass = (_optional(path, table, name) for name in ("lower_deg", "upper_deg", "speed_deg_s", "mass_kg"))
    com = np.nan_to_num(np.stack([_optional(path, table, f"com_{c}_mm") for c in "xyz"], axis=1))
    behind = _links(convention, axes[0], flange[0])
    remarks = [f"columns not used: {', '.join(table.unused)}"] if table.unused else []
    remarks += ["joint angles are counted from the table's theta: the angles a controller shows must be those of the table's q"]
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


@dataclass
class _Table:
    """headings: as they stand, by our name; units: of each in pint's words; rows: cells by our name."""

    headings: dict[str, str]
    units: dict[str, str]
    rows: list[dict[str, Any]]
    unused: list[str]


def _table(path: Path) -> _Table:
    text = _text(path)
    headings, cells = _csv(path, text) if path.suffix == ".csv" else _yaml(path, text)
    table = _Table({}, {}, [], [])
    names: list[str | None] = []
    for heading in headings:
        name, unit = _known(str(heading))
        if name in table.headings:
            raise ConfigError(f"{path}: the columns '{table.headings[name]}' and '{heading}' are both {name}; remove one")
        names.append(name)
        if name is None:
            table.unused += [str(heading)] if str(heading).strip() else []
            continue
        table.headings[name], table.units[name] = str(heading), unit
    table.rows = [{name: cell for name, cell in zip(names, row, strict=True) if name is not None} for row in cells]
    if len(table.rows) < 2:
        raise ConfigError(f"{path}: a table of at least two rows with columns theta_deg, d_mm, a_mm, alpha_deg is needed")
    return table


def _known(heading: str) -> tuple[str | None, str]:
    """Our name of a column, None for one that is not known, and its unit."""
    plain = heading.strip()
    if plain.lower() in OTHERS:
        return plain.lower(), ""
    name, unit, _ = split_heading(plain)
    name = GREEK.get(name, name)
    return (name, unit) if name in (*ANGLES, *LENGTHS) else (None, "")


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()[: MAX_BYTES + 1]
    except OSError as error:
        raise ConfigError(f"{path}: the table cannot be read ({error.strerror}); correct the path") from None
    try:
        return data.decode("utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: the table is not UTF-8 text; save it as UTF-8") from None


def _csv(path: Path, text: str) -> tuple[list[str], list[list[Any]]]:
    lines = [(i, line) for i, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise ConfigError(f"{path}: is empty; a header and a row of each axis are needed")
    separator = max((",", ";", "\t"), key=lines[0][1].count)
    try:
        split = [(i, next(csv.reader([line], delimiter=separator, strict=True))) for i, line in lines]
    except (csv.Error, StopIteration) as error:
        raise ConfigError(f"{path}: is not a CSV file ({error}); save it as comma-separated text") from None
    header = split[0][1]
    while header and not header[-1].strip():
        header.pop()
    rows = []
    for number, row in split[1:]:
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise ConfigError(
                f"{path}:{number}: the row has {len(row)} cells, the header {len(header)}; correct the row (decimal point and comma, or "
                "decimal comma and semicolon)"
            )
        rows.append(row)
    return header, rows


def _yaml(path: Path, text: str) -> tuple[list[str], list[list[Any]]]:
    try:
        data = yaml12.load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from None
    rows = data.get("rows") if isinstance(data, dict) else data
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(f"{path}: a table of at least two rows with columns theta_deg, d_mm, a_mm, alpha_deg is needed")
    headings = list(dict.fromkeys(key for row in rows for key in row))
    return headings, [[row.get(key) for key in headings] for row in rows]


def _column(path: Path, table: _Table, name: str) -> np.ndarray:
    """(n,) rad or mm of a column whose unit is said. Raises ConfigError."""
    wanted, example = ("rad", "deg") if name in ANGLES else ("mm", "mm")
    if not table.units.get(name):
        known = ", ".join(sorted([*table.headings.values(), *table.unused]))
        other = "rad" if name in ANGLES else "m"
        raise ConfigError(
            f"{path}: has no column {name}_{example} or {name}_{other} (its columns are {known}); the unit is part of the name"
        )
    out = []
    for i, row in enumerate(table.rows):
        value, unit = _number(path, i, table.headings[name], row.get(name))
        try:
            out.append(converted(value, unit or table.units[name], wanted))
        except UnknownUnitError:
            stated = unit or table.units[name]
            raise ConfigError(f"{path}: '{table.headings[name]}': '{stated}' is no unit of {name}; correct the heading") from None
    return np.array(out)


def _optional(path: Path, table: _Table, name: str) -> np.ndarray:
    """(n,), nan where a row is silent."""
    cells = [row.get(name) for row in table.rows]
    return np.array([np.nan if cell in (None, "") else _number(path, i, name, cell)[0] for i, cell in enumerate(cells)])


def _number(path: Path, row: int, name: str, value: Any) -> tuple[float, str]:
    """A number and the unit that the cell itself says: 90° are degrees, pi/2 are radians."""
    text, unit = str(value).strip(), ""
    if text.endswith("°"):
        text, unit = text[:-1].strip(), "deg"
    if match := _PI.fullmatch(text):
        sign, times, divisor = -1.0 if match[1] == "-" else 1.0, float(match[2] or 1), float(match[3] or 1)
        return sign * times * np.pi / divisor if divisor else np.nan, "rad"
    if _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        number = np.nan if "_" in text or isinstance(value, bool) else float(text)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ConfigError(f"{path}: row {row + 1}: {name} is {value!r}, not a number; correct it")
    return number, unit


def _refuse_prismatic(path: Path, table: _Table) -> None:
    for i, row in enumerate(table.rows):
        kind = str(row.get("type") or row.get("kind") or "").strip().lower()
        if kind and kind not in ("r", "rev", "revolute", "rotational", "rotary"):
            raise ConfigError(f"{path}: row {i + 1} is of type '{row.get('type') or row.get('kind')}'; an arm of revolute joints is needed")


def _refuse_other_units(path: Path, table: _Table) -> None:
    """Raise ConfigError for lengths that cannot be in the unit of their heading, and angles likewise."""
    lengths = np.concatenate([np.abs(_column(path, table, name)) for name in LENGTHS])
    if 0 < lengths.sum() < SHORTEST_ARM_MM:
        raise ConfigError(f"{path}: all d and a are {lengths.sum():.3g} mm together, which looks like metres; name the columns d_m, a_m")
    if lengths.sum() > LONGEST_ARM_MM:
        raise ConfigError(f"{path}: all d and a are {lengths.sum() / 1e3:.3g} m together, which looks like mm; name the columns d_mm, a_mm")
    for name in ANGLES:
        said = [_number(path, i, name, row.get(name)) for i, row in enumerate(table.rows)]
        plain = np.array([value for value, unit in said if not unit])
        steps = np.rint(plain / (np.pi / 4))
        radians = (steps != 0) & (np.abs(steps) <= 8) & (np.abs(plain - steps * np.pi / 4) < 2e-3)
        if table.units[name] in ("deg", "degree", "degrees") and radians.any():
            raise ConfigError(
                f"{path}: '{table.headings[name]}' has {plain[radians][0]:g}, which looks like radians; name the column {name}_rad"
            )
        if table.units[name] in ("rad", "radian", "radians") and np.abs(plain).max(initial=0.0) > 2 * np.pi + 1e-3:
            largest = plain[np.abs(plain).argmax()]
            raise ConfigError(f"{path}: '{table.headings[name]}' has {largest:g}, which looks like degrees; name the column {name}_deg")
