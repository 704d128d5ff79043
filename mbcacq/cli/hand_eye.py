"""``mbcacq hand-eye``: hand-eye calibration of a camera, view by view."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

import mbcacq
from mbcacq import devices
from mbcacq.camera import intrinsics
from mbcacq.cli.calibrate import lines_of
from mbcacq.cli.data import ABOVE_ZERO, BoardSaid
from mbcacq.cli.declared import FOLDER, Answer, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.terminal import echo
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.files import atomic_write
from mbcacq.geometry import orientations
from mbcacq.model import cell, json_text
from mbcacq.quantities import in_degrees
from mbcacq.recording.datasets import loose_table, pose_columns
from mbcacq.workflow import calibrate, hand_eye, load, view_sources

if TYPE_CHECKING:
    import numpy as np


@subcommand("hand-eye")
def command(
    images: Path | None = option("Folder into which the images fall.", FOLDER),
    device: str | None = option("Camera of OpenCV: its number, or the address of a stream.", metavar="CAMERA"),
    said: BoardSaid = BoardSaid,  # type: ignore[assignment]
    follow: Path | None = option("Plan of an arm that is followed and never moved (follow: {} below robot).", PlanPath()),
    flange: str | None = option("Orientation of poses: kuka, fanuc, ur, abb, yaskawa .., ZYX, xyz, vector, wxyz.", metavar="CONVENTION"),
    eye_in_hand: bool = option("The camera is on the flange [default]."),
    eye_to_hand: bool = option("The camera is fixed, the board on the flange."),
    enough: float = option("U (k = 2) of x, y and z that ends it, mm.", ABOVE_ZERO, default=0.1),
    wait: float = option("Time without a new view after which it ends, s.", click.FloatRange(0), default=600.0),
    out: Path = option("Folder to write.", FOLDER, default=Path("hand-eye")),
    force: bool = option("Write into the folder although it exists."),
) -> Answer:
    """Calibrate the hand-eye transformation of a camera view by view: after each, how well it is known and where the next view should be.

    Poses of the flange are typed or pasted, a line each; or they are the rows of --poses, or those of the arm of --follow. Type n where a
    view is out of reach, and an empty line to end. OUT/index.html shows the last image with the points found and the next view.

    \b
    Examples:
      mbcacq hand-eye --device 0 --board circles --size 9x7 --pitch 20 --flange ur
      mbcacq hand-eye --images incoming --board chessboard --size 9x6 --pitch 20 \\
        --poses flange.csv
    """
    board = said.shown()
    if (images is None) == (device is None):
        raise ConfigError("give the images' --images FOLDER, or the camera's --device NUMBER")
    if said.poses is not None and follow is not None:
        raise ConfigError("poses are those of --poses or of --follow; give one of the two")
    if said.poses is None and follow is None and flange is None:
        raise ConfigError("--flange CONVENTION is missing: how the poses that you type write their orientation, such as kuka, ur or abb")
    load.refuse_existing(out, force, f"{out} exists; give another --out, or --force to write into it")
    if eye_in_hand and eye_to_hand:
        raise ConfigError("the camera is on the flange or fixed; give one of --eye-in-hand and --eye-to-hand")
    measurement = cell.TARGET_IN_BASE if eye_to_hand else cell.ARTEFACT_IN_SCANNER
    session = hand_eye.HandEyeSession(out, board, intrinsics.read_intrinsics(said.camera) if said.camera else None, measurement, enough)
    with ExitStack() as stack:
        source: view_sources.VideoCamera | view_sources.ImageFolder = (
            view_sources.ImageFolder(images) if images else view_sources.VideoCamera(str(device))
        )
        arm: view_sources.TypedPoses | view_sources.PoseFile | view_sources.FollowedArm
        if follow is not None:
            session.robot, arm = stack.enter_context(view_sources.followed_arm(follow))
        elif said.poses is not None:
            arm = view_sources.PoseFile(said.poses, loose_table.TableOptions(flange=flange))
        else:
            arm = view_sources.TypedPoses(lambda: devices.typed_line(threading.Event()), str(flange), lambda text: echo(text, err=True))
        lead(session, source, arm, _Waiting(wait), flange)
    return _ended(session)


class _Waiting:
    """Waits for files and arms; False once nothing came for so long, or Ctrl-C was pressed. ``came()`` begins anew."""

    def __init__(self, longest_s: float) -> None:
        self._longest_s, self._since = longest_s, time.monotonic()

    def came(self) -> None:
        self._since = time.monotonic()

    def __call__(self) -> bool:
        time.sleep(0.1)
        return time.monotonic() - self._since < self._longest_s


def lead(
    session: hand_eye.HandEyeSession,
    images: view_sources.VideoCamera | view_sources.ImageFolder,
    poses: view_sources.TypedPoses | view_sources.PoseFile | view_sources.FollowedArm,
    wait: _Waiting,
    convention: str | None,
) -> None:
    """Take view after view until the camera's place is known as well as was asked for, or nothing comes any more."""
    said = f"show the whole board to the camera, and keep the arm still; {(session.folder / 'index.html').resolve().as_uri()} shows more"
    echo(said, err=True)
    try:
        while not session.enough:
            view = session.next_view()
            session.show(view, said)
            number = len(session.views) + len(session.missing) + 1
            echo(f"view {number}: {view.in_words()}{_flange(session.flange_at(view), convention)}", err=True)
            wait.came()
            pose = poses.next(wait)
            if isinstance(pose, str):
                session.refused.append(view.T)
                continue
            grey = None if pose is None else images.next(wait)
            if pose is None or grey is None:
                break
            said = session.add(grey, pose)
            echo(said, err=True)
    except KeyboardInterrupt:
        echo("ended by Ctrl-C; what was measured is kept", err=True)
    session.show(None, f"after {len(session.views)}: {session.known()}")


def _flange(T_base_flange: np.ndarray | None, convention: str | None) -> str:
    """Where the flange is then, as a clause; '' while nobody knows."""
    if T_base_flange is None:
        return ""
    x, y, z = T_base_flange[:3, 3]
    place = f"; the flange is near x {x:.0f}, y {y:.0f}, z {z:.0f} mm"
    word = pose_columns.named_convention(convention, "--flange") if convention else "matrix"
    if word in ("matrix", *orientations.QUATERNIONS):
        return place
    turn = orientations.to_numbers(T_base_flange[None, :3, :3], word)[0]
    if word == "vector":
        return f"{place}, rotation vector {', '.join(f'{v:.2f}' for v in turn)} rad"
    return f"{place}, {', '.join(f'{v:.0f}' for v in in_degrees(turn))}° ({orientations.in_words(word)})"


def _ended(session: hand_eye.HandEyeSession) -> Answer:
    """Write the observation set; its calibration. Raises CalibrationError where the views are too few."""
    folder = session.finish()
    if folder is None or session.place is None:
        raise CalibrationError(
            f"the board was seen in {len(session.views)}: {session.known() or 'nothing is known'}; take more with --force"
        )
    result = calibrate.calibration_content(folder, mbcacq.CalibrationOptions(kinematics=False))
    file = atomic_write.write_file(session.folder / "result.json", json_text.sealed_text(result))
    known = "" if session.enough else f", which is more than the {session.enough_mm:g} mm that were asked for: take more views"
    document = {**result, "enough": session.enough, "files": {"set": str(folder), "result": str(file)}}
    lines = [*lines_of(result), f"{len(session.views)} views; {session.known()}{known}"]
    then = "write the transform for ROS, controllers and others", command_line("export", file, "--results", session.folder / "export")
    return Answer(document, lines, then, wide=True)
