"""An arm of a table of Denavit-Hartenberg rows, CSV or YAML, in the standard or the modified convention."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.files.csv_text import CsvText, read_csv_text, read_text, text_of_mappings
from mbcacq.files.table import Column, Table, TableSchema, as_table
from mbcacq.files.units import number_with_unit
from mbcacq.geometry import se3
from mbcacq.model import yaml12
from mbcacq.model.robot_import.source import ArmSource
from mbcacq.quantities import in_degrees

MAX_BYTES = 1_000_000
ANGLES, LENGTHS = ("theta", "alpha"), ("d", "a")
NEEDED = "a table of at least two rows with columns theta_deg, d_mm, a_mm, alpha_deg"
ROWS = TableSchema(
    "a table of Denavit-Hartenberg rows",
    (
        Column("theta", "rad", written="deg", aliases=("θ", "th")),
        Column("d", "mm"),
        Column("a", "mm"),
        Column("alpha", "rad", written="deg", aliases=("α",)),
        Column("lower", "rad", written="deg", required=False),
        Column("upper", "rad", written="deg", required=False),
        Column("speed", "rad/s", written="deg/s", required=False),
        *(Column(f"{end}_of_slide", "mm", required=False, aliases=(end,)) for end in ("lower", "upper")),
        Column("speed_of_slide", "mm/s", required=False, aliases=("speed",)),
        Column("mass", "kg", required=False),
        *(Column(f"com_{axis}", "mm", required=False) for axis in "xyz"),
        Column("joint", kind="text", required=False),
        Column("type", kind="text", required=False, aliases=("kind", "joint_type", "jointtype", "sigma")),
    ),
    max_bytes=MAX_BYTES,
    comment="#",
)
SHORTEST_ARM_MM, LONGEST_ARM_MM = 20.0, 50e3
REACHED = 200  # postures in which the reach is seen
REVOLUTE = ("r", "rev", "revolute", "rotational", "rotary", "0", "0.0")  # sigma of Corke's toolbox is 0, and 1 of a slide
PRISMATIC = ("p", "prismatic", "sliding", "slide", "linear", "1", "1.0")


def read_dh_table(path: Path, convention: str) -> ArmSource:
    """convention: 'standard', each row Rz(theta + q) Tz(d) Tx(a) Rx(alpha); or 'modified' (Craig), Rx(alpha) Tx(a) Rz(theta + q) Tz(d). A
    prismatic row has q added to d.

    Raises ConfigError for a table that lacks a column or a number.
    """
    table = _table(path)
    slides = _prismatic(table)
    theta, d, a, alpha = table.numbers(("theta", "d", "a", "alpha")).T
    _refuse_other_units(table, _reach(convention, theta, d, a, alpha))

    def forward(q: np.ndarray) -> np.ndarray:
        return _frames(convention, theta, d, a, alpha, q, slides)[1]

    axes, flange = _frames(convention, theta, d, a, alpha, np.zeros((1, len(table))))
    lower, upper, speed, mass = (_optional(table, name) for name in ("lower", "upper", "speed", "mass"))
    for quantity, column in ((lower, "lower"), (upper, "upper"), (speed, "speed")):
        quantity[slides] = _optional(table, f"{column}_of_slide")[slides]
    if (silent := slides & np.isnan(lower + upper)).any():
        row = int(np.argmax(silent))
        raise ConfigError(f"{table.path}: row {row + 1} slides and has no lower_mm and upper_mm; give both")
    com = np.stack([_optional(table, f"com_{c}") for c in "xyz"], axis=1)
    names = table.text("joint") if table.has("joint") else ("",) * len(table)
    behind = _links(convention, axes[0], flange[0])
    remarks = [f"columns not used: {', '.join(table.unused)}"] if table.unused else []
    if bare := [str(i + 1) for i in np.flatnonzero((mass > 0) & np.isnan(com).any(axis=1))]:
        remarks.append(f"the mass of rows {', '.join(bare)} is put at the link's own frame, for want of com_x_mm, com_y_mm, com_z_mm")
    remarks += ["joint angles are counted from the table's theta: the angles a controller shows must be those of the table's q"]
    return ArmSource(
        name=path.stem,
        base="base",
        flange="flange",
        joints=[name.strip() or f"A{i + 1}" for i, name in enumerate(names)],
        direction=axes[0, :, :3, 2],
        point=axes[0, :, :3, 3],
        T_base_flange=flange[0],
        limits=np.stack([lower, upper], axis=1),
        speed=speed,
        mass=np.nan_to_num(mass),
        com=se3.apply(behind, np.nan_to_num(com)),
        forward=forward,
        remarks=remarks,
        sliding=tuple(np.flatnonzero(slides).tolist()),
    )


def _frames(
    convention: str,
    theta: np.ndarray,
    d: np.ndarray,
    a: np.ndarray,
    alpha: np.ndarray,
    q: np.ndarray,
    slides: np.ndarray | Sequence[bool] = (),
) -> tuple[Any, Any]:
    """Frames (P, n, 4, 4) whose z are the joint axes, and the flange (P, 4, 4). slides: (n,) bool, rows of which q is added to d."""
    T, axes = np.broadcast_to(np.eye(4), (len(q), 4, 4)), []
    along = np.broadcast_to(slides if len(slides) else False, q.shape)
    angle, shift = theta + np.where(along, 0.0, q), d + np.where(along, q, 0.0)
    for i in range(len(theta)):
        turn, lift = np.zeros((len(q), 3)), np.zeros((len(q), 3))
        turn[:, 2], lift[:, 2] = angle[:, i], shift[:, i]
        about_z = se3.transform(se3.rotation_exp(turn), lift)
        about_x = se3.transform(se3.rotation_exp(np.array([alpha[i], 0.0, 0.0])), np.array([a[i], 0.0, 0.0]))
        T = T if convention == "standard" else T @ about_x
        axes.append(T)
        T = T @ about_z @ about_x if convention == "standard" else T @ about_z
    return np.stack(axes, axis=1), T


def _links(convention: str, axes: np.ndarray, flange: np.ndarray) -> np.ndarray:
    """(n, 4, 4): the frames in which the table's convention gives centres of gravity."""
    return axes if convention == "modified" else np.concatenate([axes[1:], flange[None]])


def _table(path: Path) -> Table:
    text = _yaml(path) if path.suffix.lower() in (".yaml", ".yml") else read_csv_text(path, max_bytes=MAX_BYTES, comment="#")
    table = as_table(path, text, ROWS)
    if len(table) < 2:
        raise ConfigError(f"{path}: {NEEDED} is needed")
    return table


def yaml_content(path: Path) -> Any:
    """What a YAML file holds. Raises ConfigError where it is none."""
    try:
        return yaml12.load(read_text(path, MAX_BYTES))
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from None


def _yaml(path: Path) -> CsvText:
    """The rows of a YAML list of mappings, or of its list ``rows``."""
    data = yaml_content(path)
    rows = data.get("rows") if isinstance(data, dict) else data
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(f"{path}: {NEEDED} is needed")
    return text_of_mappings(rows, "row")


def _optional(table: Table, name: str) -> np.ndarray:
    """(n,), nan where a row is silent."""
    return table.number(name, empty=np.nan) if table.has(name) else np.full(len(table), np.nan)


def _prismatic(table: Table) -> np.ndarray:
    """(n,) bool: rows whose joint slides."""
    kinds = [kind.strip().lower() for kind in table.text("type")] if table.has("type") else [""] * len(table)
    for i, kind in enumerate(kinds):
        if kind and kind not in (*REVOLUTE, *PRISMATIC):
            raise ConfigError(f"{table.where(i, 'type')}: row {i + 1} is of type '{kind}'; give revolute or prismatic")
    return np.isin(kinds, PRISMATIC)


def _reach(convention: str, theta: np.ndarray, d: np.ndarray, a: np.ndarray, alpha: np.ndarray) -> float:
    """How far from the base the flange comes, mm: the d of nearly parallel axes may be large and cancel."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (REACHED, len(theta)))
    return float(np.median(np.linalg.norm(_frames(convention, theta, d, a, alpha, q)[1][:, :3, 3], axis=1)))


def _refuse_other_units(table: Table, reach: float) -> None:
    """Raise ConfigError for lengths that cannot be in the unit of their heading, and angles likewise."""
    metres = all(table.found[name].unit == "m" for name in LENGTHS)
    if 0 < reach < SHORTEST_ARM_MM:
        advice = "which looks like metres; name the columns d_m, a_m" if not metres else "less than any arm; correct the rows"
        raise ConfigError(f"{table.path}: the flange of these rows is {reach:.3g} mm from the base, {advice}")
    if reach > LONGEST_ARM_MM:
        advice = "which looks like mm; name the columns d_mm, a_mm" if metres else "more than any arm; correct the rows, or their unit"
        raise ConfigError(f"{table.path}: the flange of these rows is {reach / 1e3:.3g} m from the base, {advice}")
    for name in ANGLES:
        by_heading = np.array([number_with_unit(cell) is None for cell in table.text(name)])
        plain, heading = table.number(name)[by_heading], f"{table.path}: '{table.heading(name)}'"
        degrees = in_degrees(plain)
        unit = table.found[name].unit
        steps = np.rint(degrees / (np.pi / 4))
        radians = (steps != 0) & (np.abs(steps) <= 8) & (np.abs(degrees - steps * np.pi / 4) < 2e-3)
        if unit == "deg" and radians.any():
            raise ConfigError(f"{heading} has {degrees[radians][0]:g}, which looks like radians; name the column {name}_rad")
        if unit == "rad" and np.abs(plain).max(initial=0.0) > 2 * np.pi + 1e-3:
            raise ConfigError(f"{heading} has {plain[np.abs(plain).argmax()]:g}, which looks like degrees; name the column {name}_deg")
