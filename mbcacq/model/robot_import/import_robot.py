"""A robot file of this tool from a description that people have, compared with it before it is handed on."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationError

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.chain_from_axes import ChainInFrames, chain_from_axes
from mbcacq.model import yaml12
from mbcacq.model.bounds import BOUNDS, refuse_beyond
from mbcacq.model.cell_schema import RobotSpec, joint_key
from mbcacq.model.robot_import.dh_table import read_dh_table, yaml_content
from mbcacq.model.robot_import.mjcf import read_mjcf
from mbcacq.model.robot_import.source import ArmSource
from mbcacq.model.robot_import.ur_calibration import is_ur_calibration, read_ur_calibration
from mbcacq.model.robot_import.urdf import read_urdf
from mbcacq.model.yaml_source import name_of
from mbcacq.quantities import from_degrees, in_degrees

POSTURES = 200  # random ones at which both forward kinematics are compared
FIRST_BYTES = 100_000  # of a file, within which its first element stands
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_ELEMENT = re.compile(r"<([A-Za-z_][\w.-]*)")
LARGEST_MISS_MM, LARGEST_MISS_RAD = 1e-3, 1e-6  # the file's rounding stays far below


@dataclass(frozen=True)
class ImportedRobot:
    """text: YAML of the robot file. base, flange: names in the source. miss_mm, miss_rad: largest difference of the two forward
    kinematics. remarks: what the reader of the file should know. T_given_base, T_flange_given: (4, 4), see ChainInFrames."""

    text: str
    base: str
    flange: str
    joints: tuple[str, ...]
    miss_mm: float
    miss_rad: float
    remarks: tuple[str, ...]
    T_given_base: np.ndarray
    T_flange_given: np.ndarray


def import_robot(
    path: Path | str,
    *,
    base: str | None = None,
    flange: str | None = None,
    convention: Literal["standard", "modified"] | None = None,
    name: str | None = None,
    speed_deg_s: float | None = None,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> ImportedRobot:
    """Read the description of an arm and write it as a robot file. It is a URDF, xacro or MJCF file, a DH table (CSV, YAML; then
    ``convention`` must be given) or the factory calibration of a UR arm (YAML, as ``ur_calibration`` writes it).

    base, flange: links (URDF), bodies or sites (MJCF); default: what the file's names suggest. speed_deg_s: of every axis where the source
    states none. packages: folders of the ROS packages that a xacro names and that are not found above it; arguments: of its ``$(arg ..)``.
    Raises ConfigError for a file that is not understood, or whose forward kinematics the rows do not repeat.
    """
    path = Path(path)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers without bound are refused by the next line
        source = _read(path, base, flange, convention, packages, arguments)
    _refuse_endless(path, source)
    rows = chain_from_axes(source.direction, source.point, source.T_base_flange, source.sliding)
    rows = replace(rows, chain=replace(rows.chain, follows=source.follows))
    remarks = [*source.remarks, *_frame_remarks(rows)]
    speed = source.speed
    if np.isnan(speed).any() and speed_deg_s is not None:
        speed = np.where(np.isnan(speed) & ~rows.chain.prismatic, from_degrees(speed_deg_s), speed)
        remarks = [r for r in remarks if "--speed" not in r]
    if (silent := np.isnan(speed) | (speed <= 0)).any() and not any("speed" in r for r in remarks):
        remarks.append(
            f"the file states no speed of {', '.join(np.array(source.joints)[silent])}; an arm that is to move needs all of them: "
            "--speed gives one for all, or add speed_deg_s of each"
        )
    if np.isnan(source.limits).any():
        remarks.append("the file states no limits of some joints; an arm that is to move needs all of them: add limits_deg of each")
    if not source.mass.any():
        remarks.append("the file states no masses; effects of gravity are then less well predicted")
    text = _text(path, source, rows, speed, name or source.name, remarks)
    miss_mm, miss_rad = _compared(path, text, rows, source)
    return ImportedRobot(
        text=text,
        base=source.base,
        flange=source.flange,
        joints=tuple(source.joints),
        miss_mm=miss_mm,
        miss_rad=miss_rad,
        remarks=tuple(remarks),
        T_given_base=rows.T_given_base,
        T_flange_given=rows.T_flange_given,
    )


def _read(
    path: Path,
    base: str | None,
    flange: str | None,
    convention: str | None,
    packages: Mapping[str, Path] | None,
    arguments: Mapping[str, str] | None,
) -> ArmSource:
    kind = path.suffix.lower()
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise ConfigError(f"{path} {what}; give the file that describes the arm")
    if kind in (".yaml", ".yml") and is_ur_calibration(content := yaml_content(path)):
        return read_ur_calibration(path, content)
    if kind in (".csv", ".yaml", ".yml"):
        if convention is None:
            raise ConfigError(f"{path}: which convention do its rows follow? say --convention standard or --convention modified")
        return read_dh_table(path, convention)
    if kind not in (".urdf", ".xacro", ".mjcf", ".xml"):
        raise ConfigError(f"{path}: '{path.suffix}' is none of .urdf, .xacro, .mjcf, .xml, .csv, .yaml; give a description of these kinds")
    element = _first_element(path)
    if element == "mujocoinclude":
        raise ConfigError(f"{path}: is a part of an MJCF file (<mujocoinclude>); import the file that includes it")
    if element == "mujoco":
        try:
            return read_mjcf(path, base, flange)
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: a name in it is not UTF-8; save the file in UTF-8") from None
    return read_urdf(path, base, flange, packages, arguments)


def _refuse_endless(path: Path, source: ArmSource) -> None:
    """Raises ConfigError for an arm with a length, mass or joint limit that no arm has, or one that is no number. A limit that is not
    stated is NaN."""
    for number, limits in enumerate(in_degrees(source.limits)):
        if number not in source.sliding and (np.abs(limits) > BOUNDS["joint_angle"].high).any():
            said = f"joint '{source.joints[number] or number + 1}' has the limits {limits[0]:g} to {limits[1]:g}°"
            raise ConfigError(f"{path}: {said}; give both as angles, or none where the joint turns without end")
    sizes = {"place of a joint": source.point, "flange": source.T_base_flange[:3, 3], "centre of gravity": source.com}
    for what, values in sizes.items():
        refuse_beyond("position", values, f"{path}: a {what} (mm)")
    refuse_beyond("mass", source.mass, f"{path}: a mass")
    refuse_beyond("direction", source.direction, f"{path}: a joint's axis")


def _first_element(path: Path) -> str:
    """The name of the first element of a file, '' where none is seen: a URDF may have a <mujoco> inside."""
    try:
        with path.open("rb") as file:
            data = file.read(FIRST_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: the robot description cannot be read ({error.strerror}); correct the path") from None
    mark = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    text = _COMMENT.sub("", data.decode("utf-16" if mark else "latin-1", "replace"))
    found = _ELEMENT.search(text)
    return found[1] if found else ""


def _frame_remarks(rows: ChainInFrames) -> list[str]:
    out = []
    for T, sentence in (
        (rows.T_given_base, "the rows' base lies on axis 1 and differs from the file's: X Y Z A B C of it there {} (mm, °)"),
        (rows.T_flange_given, "the rows' flange lies on the last axis and differs from the file's: X Y Z A B C of that in it {} (mm, °)"),
    ):
        xyz, abc = se3.to_abc(T)
        said = [_short(v, 4) for v in (*xyz, *in_degrees(abc))]
        if any(v != "0" for v in said):
            out.append(sentence.format(" ".join(said)))
    return out


def _text(path: Path, source: ArmSource, rows: ChainInFrames, speed: np.ndarray, name: str, remarks: list[str]) -> str:
    chain = rows.chain
    frames = chain.frames(np.zeros((1, chain.n)))[0]
    com = se3.apply(se3.inverse(frames[1:]), se3.apply(se3.inverse(rows.T_given_base), source.com))
    lines = [
        _comment(f"Imported from {path.name}, {source.base} to {source.flange}: {', '.join(source.joints)}"),
        "# H_i = Rz(sign*q_i + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta); q as the file counts the joints' angles.",
        "# Centres of gravity stand in the frame of their own link (behind its row).",
        *map(_comment, remarks),
        f"name: {yaml12.dump(name, width=1000).splitlines()[0]}",
    ]
    down = rows.T_given_base[:3, :3].T @ np.array([0.0, 0.0, -1.0])
    if np.abs(down - [0, 0, -1]).max() > 1e-9:
        lines.append(f"base_to_gravity: [{', '.join(_short(v) for v in down)}]")
    if chain.root is not None:
        rotation = ", ".join(f"[{', '.join(_short(v, 15) for v in row)}]" for row in chain.root[:3, :3])
        place = ", ".join(_short(v) for v in chain.root[:3, 3])
        lines.append(f"base_to_first_axis: {{rotation: [{rotation}], translation_mm: [{place}]}}")
    lines.append("links:")
    names, slides = _names(source), chain.prismatic
    followed = {joint: (leader, ratio) for joint, leader, ratio in chain.follows}
    for i in range(chain.n):
        kind = "prismatic" if slides[i] else "revolute"
        content = [f"name: {names[i]}"] if names else []
        content += ["type: prismatic"] if slides[i] else []
        if i in followed:
            leader, ratio = followed[i]
            unit = 1.0 if slides[i] == slides[leader] else (in_degrees(1.0) if slides[leader] else from_degrees(1.0))
            content.append(f"follows: {{link: {leader + 1}, ratio: {_short(ratio * unit)}}}")
        shown = (lambda values: values) if slides[i] else in_degrees
        row = {"theta_deg": in_degrees(chain.theta[i]), "d_mm": chain.d[i], "a_mm": chain.a[i], "alpha_deg": in_degrees(chain.alpha[i])}
        if abs(chain.beta[i]) > 1e-11:
            row["beta_deg"] = in_degrees(chain.beta[i])
        content += [f"{key}: {_short(value)}" for key, value in row.items()]
        if not np.isnan(source.limits[i]).any():
            content.append(f"{joint_key('limits', kind)}: [{', '.join(_short(v, 6) for v in shown(source.limits[i]))}]")
        if np.isfinite(speed[i]) and speed[i] > 0:
            content.append(f"{joint_key('speed', kind)}: {_short(shown(speed[i]), 6)}")
        line = "  - {" + ", ".join(content)
        if source.mass[i] > 0:
            lines.append(line + ",")
            line = f"     mass_kg: {_short(source.mass[i], 6)}, com_mm: [{', '.join(_short(v, 3) for v in com[i])}]"
        lines.append(line + "}")
    return "\n".join(lines) + "\n"


ARM_ON_AXES = 5  # turning axes behind the slides of an arm that is carried; fewer are the wrist of a gantry


def _names(source: ArmSource) -> list[str]:
    """E1 .. for the slides below an arm, A1 .. for its own axes; none where no slide carries an arm."""
    n = len(source.joints)
    below = next((i for i in range(n) if i not in source.sliding), n)
    own = n - below
    return [*(f"E{i + 1}" for i in range(below)), *(f"A{i + 1}" for i in range(own))] if below and own >= ARM_ON_AXES else []


def _comment(sentence: str) -> str:
    """A line of YAML that says nothing to a reader of YAML, whatever characters names of the source have: U+2028 ends a line there."""
    return f"# {' '.join(''.join(c if c.isprintable() else ' ' for c in sentence).split())}."


def _short(value: float, digits: int = 9) -> str:
    """As few digits as say the number to ``digits`` decimals; never as 1e-09, which YAML takes for a word."""
    text = f"{round(float(value), digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _compared(path: Path, text: str, rows: ChainInFrames, source: ArmSource) -> tuple[float, float]:
    """Largest difference (mm, rad) of the file that is written and its source. Raises ConfigError where they differ."""
    try:
        model = RobotSpec.model_validate(yaml12.load(text)).model()
    except ValidationError as error:
        first = error.errors()[0]
        what, value = name_of(first["loc"]), first["input"]
        raise ConfigError(f"{path}: makes a robot whose {what} is {value}: {first['msg'].lower()}; correct the file") from None
    limits = np.nan_to_num(source.limits, nan=np.pi)
    limits[[joint for joint, _, _ in source.follows]] = 0.0
    q = np.random.default_rng(0).uniform(np.minimum(*limits.T), np.maximum(*limits.T), (POSTURES, model.n))
    made, given = rows.T_given_base @ model.chain.flange(q) @ rows.T_flange_given, source.forward(q)
    miss_mm = float(np.abs(made[:, :3, 3] - given[:, :3, 3]).max())
    miss_rad = float(np.abs(made[:, :3, :3] - given[:, :3, :3]).max())
    if not (miss_mm < LARGEST_MISS_MM and miss_rad < LARGEST_MISS_RAD):
        raise ConfigError(f"{path}: the rows made from it miss its forward kinematics by {miss_mm:.3g} mm; please report this file")
    return miss_mm, miss_rad
