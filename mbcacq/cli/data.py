"""``mbcacq data``: observation sets from the files that people have."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import click

from mbcacq.camera import board as boards
from mbcacq.cli.declared import FILE, FOLDER, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.errors import ConfigError
from mbcacq.model import cell
from mbcacq.recording.datasets import cell_yaml, hand_eye_sets, image_set, loose_table, observation_set
from mbcacq.recording.datasets import merge as merging
from mbcacq.workflow import load

BOARDS = ["charuco", "chessboard", "aruco", "april", "circles", "asymmetric-circles"]
ABOVE_ZERO = click.FloatRange(0, min_open=True)


@click.group("data")
def command() -> None:
    """Make an observation set of files from other programs."""


@dataclass(frozen=True)
class TableSaid:
    """What is said of tables beside their headings, and where the set goes."""

    out: Path | None = option("The folder to write [default: NAME-set here].", FOLDER)
    flange: str | None = option(
        "Orientation of the flange: kuka, fanuc, ur, abb, yaskawa .., ZYX, xyz, vector, wxyz.", metavar="CONVENTION"
    )
    target: str | None = option("Orientation of the target, likewise.", metavar="CONVENTION")
    length: str | None = option("Unit of lengths, if headings do not say [by their size].", ["mm", "m"])
    angle: str | None = option("Unit of angles, if headings do not say [by their size].", ["deg", "rad"])
    eye_in_hand: bool = option("The scanner is on the flange.")
    eye_to_hand: bool = option("The scanner is fixed, the target on the flange.")
    flange_inverted: bool | None = option(
        "Whether the flange's columns are the pose of the base as the flange sees it, or of the flange in the base.",
        None,
        "--flange-inverted/--flange-direct",
        default=None,
    )
    target_inverted: bool | None = option(
        "Whether the target's columns are the pose of the camera as the target sees it, or of the target as the camera sees it.",
        None,
        "--target-inverted/--target-direct",
        default=None,
    )
    columns: tuple[str, ...] = option("What the file calls a column, e.g. time_s=Time (repeatable).", None, "--column", metavar="OURS=FILE")
    robot: str | None = option("The arm of joint angles: one of the tool's, or a robot file.", metavar="ROBOT")
    noise: tuple[float, float, float] | None = option("Sigma of one measured point, mm.", ABOVE_ZERO, nargs=3, metavar="X Y Z")
    diameter: float | None = option("Diameter of the sphere in line profiles.", ABOVE_ZERO, metavar="MM")
    by_instrument: bool = option("An instrument measured the points, though the arm itself gives them to rounding.", None, "--measured")
    force: bool = option("Replace the set if it exists.")

    def folder(self, first: Path) -> Path:
        """The folder to write. Raises ConfigError where it exists. first: what the set is called after."""
        folder = self.out or Path(f"{first.stem}-set")
        load.refuse_existing(folder, self.force, f"{folder} exists; give another --out, or --force to replace it")
        return folder

    def options(self) -> loose_table.TableOptions:
        """Raises ConfigError."""
        if wrong := [text for text in self.columns if "=" not in text]:
            raise ConfigError(f"--column {wrong[0]}: give OURS=FILE, such as time_s=Time")
        return loose_table.TableOptions(
            flange=self.flange,
            target=self.target,
            length=self.length,
            angle=self.angle,
            measurement=cell.ARTEFACT_IN_SCANNER if self.eye_in_hand else cell.TARGET_IN_BASE if self.eye_to_hand else None,
            flange_inverted=self.flange_inverted,
            target_inverted=self.target_inverted,
            columns={ours: file for ours, _, file in (text.partition("=") for text in self.columns)},
            robot=cell_yaml.robot_of(self.robot) if self.robot else None,
            noise_mm=self.noise,
            diameter_mm=self.diameter,
            by_instrument=self.by_instrument,
        )


@dataclass(frozen=True)
class BoardSaid:
    """What is said of images of a board."""

    poses: Path | None = option("Images: the table of the arm's poses, a row for each.", FILE)
    board: str | None = option("Images: what they show.", BOARDS)
    size: str | None = option(
        "Squares of a charuco board, inner corners of a chessboard, markers, or circles of the board.", metavar="COLUMNSxROWS"
    )
    pitch: float | None = option("Side of a square, or distance of centres.", ABOVE_ZERO, metavar="MM")
    inner: float | None = option("Side of a marker, or diameter of a circle [half the pitch].", ABOVE_ZERO, metavar="MM")
    dictionary: str | None = option("Dictionary of the markers [5X5_100, april: APRILTAG_36h11].")
    camera: Path | None = option("File of the intrinsics (OpenCV, ROS, Kalibr, COLMAP) [estimated].")

    def shown(self) -> boards.Board:
        """The board. Raises ConfigError where something must be said of it."""
        if not (self.board and self.size and self.pitch):
            missing = [f"--{name}" for name in ("board", "size", "pitch") if not getattr(self, name)]
            raise ConfigError(f"{', '.join(missing)}: missing; say which board the images show")
        return boards.board_of(self.board, self.size, self.pitch, self.inner, self.dictionary)

    def read(self, files: tuple[Path, ...], options: loose_table.TableOptions) -> loose_table.UnderstoodTable:
        """The set of images. Raises ConfigError where something must be said of the board."""
        board = self.shown()
        if self.poses is None:
            raise ConfigError("--poses of the images: missing; say where the arm stood")
        return image_set.read_images(files, loose_table.table_of(self.poses, options), board, self.camera, options)


@subcommand("new", command)
def new(
    files: tuple[Path, ...] = argument(required=True),
    board: BoardSaid = BoardSaid,  # type: ignore[assignment]
    said: TableSaid = TableSaid,  # type: ignore[assignment]
) -> Answer:
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
    folder, options = said.folder(files[0]), said.options()
    images = any(getattr(board, field.name) is not None for field in fields(board))
    return _written(board.read(files, options) if images else hand_eye_sets.read_hand_eye_files(files, options), folder)


@subcommand("merge", command)
def merge(
    arm: Path = argument(),
    measured: Path = argument(),
    standstill: float = option("Shortest rest of the arm that is a pose, s.", click.FloatRange(0.05, 60), default=0.5),
    said: TableSaid = TableSaid,  # type: ignore[assignment]
) -> Answer:
    """Make an observation set of two logs of one motion: ARM (joint angles with --robot, or poses of the flange) and MEASURED (what a
    tracker, camera or scanner saw of a target), each in time.

    Their clocks may differ: the delay is found from the speeds of both. Each rest of the arm becomes a pose.

    \b
    Examples:
      mbcacq data merge joints.csv tracker.csv --robot ur10e --out cell-4
      mbcacq data merge flange.csv camera.csv --flange kuka --standstill 1.0
    """
    folder, options = said.folder(arm), said.options()
    merged = merging.merge_logs(arm, measured, options.columns, merging.RestRule(standstill))
    found = loose_table.understood(merged.table, replace(options, columns={}))
    return _written(loose_table.UnderstoodTable(found.observations, (*merged.sentences, *found.sentences)), folder)


def _written(found: loose_table.UnderstoodTable, folder: Path) -> Answer:
    """Write the set, and say how it was understood."""
    obs = found.observations
    observation_set.write_observation_set(obs, folder)
    content = {"out": str(folder), "poses": obs.n_poses, "measurements": obs.n_centres, "measurement": obs.cell.measurement}
    more = {} if obs.images is None else {"images": obs.images.to_dict()}
    return Answer(
        {**content, **more, "understood": list(found.sentences)},
        [*found.sentences, f"observation set: {folder}"],
        ("calibrate with it", command_line("calibrate", folder, "--hand-eye-only" if obs.cell.robot.of_flange_poses else "")),
    )
