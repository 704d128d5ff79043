"""``mbcacq data``: observation sets from the files that people have."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.terminal import echo

if TYPE_CHECKING:
    from mbcacq.recording.datasets.loose_table import TableOptions, UnderstoodTable


@click.group("data")
def command() -> None:
    """Make an observation set of files from other programs."""


def table_options(function: Callable[..., None]) -> Callable[..., None]:
    """What is said of tables beside their headings, and where the set goes."""
    for option in reversed(_TABLE_OPTIONS):
        function = option(function)
    return function


_TABLE_OPTIONS = (
    click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The folder to write [default: NAME-set here]."),
    click.option(
        "--flange", metavar="CONVENTION", help="Orientation of the flange: kuka, fanuc, ur, abb, yaskawa .., ZYX, xyz, vector, wxyz."
    ),
    click.option("--target", metavar="CONVENTION", help="Orientation of the target, likewise."),
    click.option("--length", type=click.Choice(["mm", "m"]), help="Unit of lengths, if headings do not say [by their size]."),
    click.option("--angle", type=click.Choice(["deg", "rad"]), help="Unit of angles, if headings do not say [by their size]."),
    click.option("--eye-in-hand", "measurement", flag_value="artefact_in_scanner", help="The scanner is on the flange."),
    click.option("--eye-to-hand", "measurement", flag_value="target_in_base", help="The scanner is fixed, the target on the flange."),
    click.option(
        "--flange-inverted/--flange-direct",
        default=None,
        help="Whether the flange's columns are the pose of the base as the flange sees it, or of the flange in the base.",
    ),
    click.option(
        "--target-inverted/--target-direct",
        default=None,
        help="Whether the target's columns are the pose of the camera as the target sees it, or of the target as the camera sees it.",
    ),
    click.option(
        "--column", "columns", multiple=True, metavar="OURS=FILE", help="What the file calls a column, e.g. time_s=Time (repeatable)."
    ),
    click.option("--robot", metavar="ROBOT", help="The arm of joint angles: one of the tool's, or a robot file."),
    click.option("--noise", nargs=3, type=click.FloatRange(0, min_open=True), metavar="X Y Z", help="Sigma of one measured point, mm."),
    click.option(
        "--diameter", "diameter_mm", type=click.FloatRange(0, min_open=True), metavar="MM", help="Diameter of the sphere in line profiles."
    ),
    click.option(
        "--measured", "by_instrument", is_flag=True, help="An instrument measured the points, though the arm itself gives them to rounding."
    ),
    click.option("--force", is_flag=True, help="Replace the set if it exists."),
    click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout."),
)


_BOARDS = ("charuco", "chessboard", "aruco", "april", "circles", "asymmetric-circles")


def image_options(function: Callable[..., None]) -> Callable[..., None]:
    """What is said of images of a board."""
    for option in reversed(_IMAGE_OPTIONS):
        function = option(function)
    return function


_IMAGE_OPTIONS = (
    click.option("--poses", type=click.Path(path_type=Path, dir_okay=False), help="Images: the table of the arm's poses, a row for each."),
    click.option("--board", "kind", type=click.Choice(_BOARDS), help="Images: what they show."),
    click.option(
        "--size",
        metavar="COLUMNSxROWS",
        help="Squares of a charuco board, inner corners of a chessboard, markers, or circles of the board.",
    ),
    click.option("--pitch", type=click.FloatRange(0, min_open=True), metavar="MM", help="Side of a square, or distance of centres."),
    click.option(
        "--inner", type=click.FloatRange(0, min_open=True), metavar="MM", help="Side of a marker, or diameter of a circle [half the pitch]."
    ),
    click.option("--dictionary", help="Dictionary of the markers [5X5_100, april: APRILTAG_36h11]."),
    click.option("--camera", type=click.Path(path_type=Path), help="File of the intrinsics (OpenCV, ROS, Kalibr, COLMAP) [estimated]."),
)


@command.command("new")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@image_options
@table_options
def new(
    files: tuple[Path, ...],
    poses: Path | None,
    kind: str | None,
    size: str | None,
    pitch: float | None,
    inner: float | None,
    dictionary: str | None,
    camera: Path | None,
    out: Path | None,
    columns: tuple[str, ...],
    robot: str | None,
    noise: tuple[float, float, float] | None,
    force: bool,
    as_json: bool,
    **said: Any,
) -> None:
    """Make an observation set of FILES and say how they were understood.

    One table (.csv, .txt): a row is a pose, with the flange's x, y, z and orientation (or joint angles, with --robot). It also has the
    measurement: the target's pose, the centre of one sphere, or those of several. If headings leave something open, the data decide. A row
    may also be a point of a line profile of a sphere (profile, profile_x_mm, profile_z_mm), with the flange's pose in each row or in a
    table before. For profiles on the move that table has the cycles, and both have times. FILES are images, or folders of images, where
    --board says what they show.

    \b
    Examples:
      mbcacq data new poses.csv
      mbcacq data new poses.csv --flange fanuc --eye-to-hand --out cell-3
      mbcacq data new flange.csv profiles.csv --diameter 30
      mbcacq data new cycles.csv points.csv --diameter 30
      mbcacq data new views --poses p.csv --board circles --size 9x7 --pitch 20
      mbcacq calibrate cell-3 --hand-eye-only
    """
    from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files

    folder = _free_folder(out or Path(f"{files[0].stem}-set"), force)
    options = options_of(columns, robot, noise, said)
    board = {"--poses": poses, "--board": kind, "--size": size, "--pitch": pitch}
    if any(value is not None for value in (*board.values(), inner, dictionary, camera)):
        _write_images(files, board, (inner, dictionary, camera), options, folder, as_json)
    else:
        _write(read_hand_eye_files(files, options), folder, as_json)


def _write_images(
    files: tuple[Path, ...],
    board: dict[str, Any],
    more: tuple[float | None, str | None, Path | None],
    options: TableOptions,
    folder: Path,
    as_json: bool,
) -> None:
    """The set of images. board: what must be said of them; more: side or diameter, dictionary, file of the intrinsics."""
    from mbcacq.camera.board import board_of
    from mbcacq.errors import ConfigError
    from mbcacq.recording.datasets.hand_eye_sets import table_of
    from mbcacq.recording.datasets.image_set import read_images

    if missing := [name for name, value in board.items() if value is None]:
        raise ConfigError(f"{', '.join(missing)} of the images: missing; say which board they show and where the arm stood")
    inner, dictionary, camera = more
    shown = board_of(board["--board"], board["--size"], board["--pitch"], inner, dictionary)
    _write(read_images(files, table_of(board["--poses"], options), shown, camera, options), folder, as_json)


@command.command("merge")
@click.argument("arm", type=click.Path(path_type=Path))
@click.argument("measured", type=click.Path(path_type=Path))
@click.option(
    "--standstill", type=click.FloatRange(0.05, 60), default=0.5, show_default=True, help="Shortest rest of the arm that is a pose, s."
)
@table_options
def merge(
    arm: Path,
    measured: Path,
    standstill: float,
    out: Path | None,
    columns: tuple[str, ...],
    robot: str | None,
    noise: tuple[float, float, float] | None,
    force: bool,
    as_json: bool,
    **said: Any,
) -> None:
    """Make an observation set of two logs of one motion: ARM (joint angles with --robot, or poses of the flange) and MEASURED (what a
    tracker, camera or scanner saw of a target), each in time.

    Their clocks may differ: the delay is found from the speeds of both. Each rest of the arm becomes a pose.

    \b
    Examples:
      mbcacq data merge joints.csv tracker.csv --robot ur10e --out cell-4
      mbcacq data merge flange.csv camera.csv --flange kuka --standstill 1.0
    """
    from mbcacq.recording.datasets.loose_table import UnderstoodTable, understood
    from mbcacq.recording.datasets.merge import RestRule, merge_logs

    folder = _free_folder(out or Path(f"{arm.stem}-set"), force)
    options = options_of(columns, robot, noise, said)
    merged = merge_logs(arm, measured, options.columns, RestRule(standstill))
    found = understood(merged.table, replace(options, columns={}))
    _write(UnderstoodTable(found.observations, (*merged.sentences, *found.sentences)), folder, as_json)


def _free_folder(folder: Path, force: bool) -> Path:
    """The folder to write. Raises ConfigError where it exists."""
    from mbcacq.workflow.load import refuse_existing

    refuse_existing(folder, force, f"{folder} exists; give another --out, or --force to replace it")
    return folder


def _write(found: UnderstoodTable, folder: Path, as_json: bool) -> None:
    """Write the set, and say how it was understood."""
    from mbcacq.recording.datasets.observation_set import write_observation_set

    obs = found.observations
    write_observation_set(obs, folder)
    if as_json:
        content = {"out": str(folder), "poses": obs.n_poses, "measurements": obs.n_centres, "measurement": obs.cell.measurement}
        more = {} if obs.images is None else {"images": obs.images.to_dict()}
        echo(json.dumps({**content, **more, "understood": list(found.sentences)}))
        return
    for sentence in found.sentences:
        echo(sentence)
    echo(f"observation set: {folder}")
    say_next("calibrate with it", command_line("calibrate", folder, "--hand-eye-only" if obs.cell.robot.of_flange_poses else ""))


def options_of(columns: tuple[str, ...], robot: str | None, noise: tuple[float, float, float] | None, said: dict[str, Any]) -> TableOptions:
    """The options of a table as the command line gives them. Raises ConfigError."""
    from mbcacq.errors import ConfigError
    from mbcacq.recording.datasets.loose_table import TableOptions, robot_of

    named = {ours: file for ours, _, file in (text.partition("=") for text in columns)}
    wrong = [text for text in columns if "=" not in text]
    if wrong:
        raise ConfigError(f"--column {wrong[0]}: give OURS=FILE, such as time_s=Time")
    return TableOptions(columns=named, robot=robot_of(robot) if robot else None, noise_mm=noise, **said)
