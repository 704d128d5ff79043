"""``mbcacq robot``: robot files from other descriptions of an arm."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.model import robot_import
from mbcacq.quantities import significant


@click.group("robot")
def command() -> None:
    """Make a robot file from a description that you have."""


@subcommand("import", command)
def import_(
    as_json: bool,
    file: Path = argument(),
    out: Path | None = option("The robot file [default: NAME.yaml here]."),
    base: str | None = option("The link (URDF) or body (MJCF) that the arm stands on [asked, or guessed from the names]."),
    flange: str | None = option("The link, body or site that carries the scanner [asked, or guessed from the names]."),
    convention: str | None = option("Convention of a table of DH rows.", ["standard", "modified"]),
    packages: tuple[str, ...] = option("Folder of a ROS package that a xacro names.", None, "--package", metavar="NAME=DIR"),
    arguments: tuple[str, ...] = option("Value of an argument of a xacro.", None, "--arg", metavar="NAME=VALUE"),
    speed: float | None = option("Largest joint speed, in °/s, if the file states none.", click.FloatRange(0, 1000, min_open=True)),
    force: bool = option("Replace the robot file if it exists."),
) -> Answer:
    """Make a robot file of FILE: .urdf, .xacro, .mjcf or .xml, a table of DH rows (.csv, .yaml), or a UR's calibration.yaml.

    The rows are compared with the file's own forward kinematics at random joint angles. Packages that a xacro names are found by the
    package.xml above the file, in ROS where it is installed, or by --package.

    \b
    Examples:
      mbcacq robot import ur10e.urdf --base base_link --flange tool0
      mbcacq robot import ur.xacro --arg ur_type=ur10e --package ur=../ur
      mbcacq robot import rows.csv --convention modified --out my_arm.yaml
    """
    folders = {key: Path(value) for key, value in _pairs("--package", packages).items()}
    given = _pairs("--arg", arguments)

    def read(base: str | None, flange: str | None):
        return robot_import.import_robot(
            file,
            base=base,
            flange=flange,
            convention=convention,  # type: ignore[arg-type]
            speed_deg_s=speed,
            packages=folders,
            arguments=given,
        )

    with StepProgress(f"reading {file.name} and comparing it at random postures"):
        found = read(base, flange)
    is_table = file.suffix.lower() in (".csv", ".yaml", ".yml")
    if sys.stdin.isatty() and not as_json and not is_table and (base is None or flange is None):
        wanted = base or click.prompt("The arm's base", default=found.base, err=True)
        end = flange or click.prompt("The arm's flange", default=found.flange, err=True)
        found = found if (wanted, end) == (found.base, found.flange) else read(wanted, end)
    target = out or Path(f"{file.stem.split('.')[0]}.yaml")
    if target.exists() and (not force or target.resolve() == file.resolve()):
        raise ConfigError(f"{target} exists already; give another --out, or --force to replace it")

    write_file(target, found.text)
    about = {"base": found.base, "flange": found.flange, "joints": list(found.joints), "remarks": list(found.remarks)}
    figures = {"miss_mm": found.miss_mm, "miss_rad": found.miss_rad}
    miss = f"{significant(found.miss_mm, 2)} mm and {significant(found.miss_rad, 2)} rad"
    lines = [
        f"{target}: {len(found.joints)} axes, {found.base} to {found.flange} ({', '.join(found.joints)})",
        f"at 200 random postures it agrees with {file.name} within {miss}",
    ]
    if file.suffix.lower() == ".urdf":
        lines.append(f"to see its meshes in the viewer, add `urdf: {file}` below `robot:` in the plan")
    tools = ("--scanner", "gocator-3210", "--artefact", "mbc-8")
    then = "make a plan for it, here with a scanner of the tool's own", command_line("plan", "new", "--robot", target, *tools)
    return Answer({"format": "mbcacq-robot-import/1", "file": str(target), **about, **figures}, lines, then, notes=found.remarks)


def _pairs(option: str, given: tuple[str, ...]) -> dict[str, str]:
    out = {}
    for pair in given:
        key, equals, value = pair.partition("=")
        if not (key and equals):
            raise ConfigError(f"{option} '{pair}' is no NAME=VALUE; write the name, '=' and the value")
        out[key] = value
    return out
