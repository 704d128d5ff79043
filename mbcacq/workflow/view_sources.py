"""Where the views of a hand-eye calibration come from: images of a camera or a folder, poses that are typed, in a file, or of an arm."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mbcacq.acquisition.cell_devices import device_makers
from mbcacq.camera.board import IMAGES, read_grey
from mbcacq.camera.intrinsics import opencv
from mbcacq.devices import Robot
from mbcacq.errors import ConfigError, ConnectError
from mbcacq.files.table import Table
from mbcacq.geometry import orientations, se3
from mbcacq.plan import load
from mbcacq.quantities import from_degrees
from mbcacq.recording.datasets.columns import flange_group
from mbcacq.recording.datasets.hand_eye_sets import table_of
from mbcacq.recording.datasets.loose_table import TableOptions, conventions_of
from mbcacq.recording.datasets.pose_columns import PoseHeadings, named_convention

STOOD_S = 1.0  # that an arm stands before its image counts
STILL = from_degrees(0.01)  # of a joint that stands
MOVED = from_degrees(2.0)  # of a joint, from which the arm is at another view
SETTLED_S = 0.3  # that a file stays as it is before it is complete
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"(?<![\d.])[A-Za-z_$]+\d*")


class Waits(Protocol):
    """Waits a moment; returns False once it is of no use to wait any longer."""

    def __call__(self) -> bool: ...


class ImageFolder:
    """Images that fall into a folder, in the order in which they come; those that are there come first, by the numbers in their names."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise ConfigError(f"{folder} is no folder; give the folder into which the images fall")
        self._folder, self._used = folder, set[Path]()

    def next(self, wait: Waits) -> np.ndarray | None:
        """(H, W) uint8; None if none comes."""
        while True:
            files = [path for path in self._folder.iterdir() if path.suffix.lower() in IMAGES and path not in self._used]
            if files:
                first = min(files, key=lambda path: [int(part) if part.isdecimal() else -1 for part in re.split(r"(\d+)", path.name)])
                if time.time() - first.stat().st_mtime > SETTLED_S:  # a file's time is of this clock
                    self._used.add(first)
                    return read_grey(first)
            if not wait():
                return None


class VideoCamera:
    """A camera of OpenCV: its number, the address of a stream, or a pattern of files."""

    def __init__(self, source: str) -> None:
        self._capture = opencv().VideoCapture(int(source) if source.isdecimal() else source)
        if not self._capture.isOpened():
            raise ConnectError(f"OpenCV opens no camera '{source}'; give its number (0 is the first), or the address of its stream")
        self._capture.set(opencv().CAP_PROP_BUFFERSIZE, 1)

    def next(self, wait: Waits) -> np.ndarray | None:
        """(H, W) uint8, taken after this call; None if the stream has ended."""
        good, image = self._capture.read()
        return opencv().cvtColor(image, opencv().COLOR_BGR2GRAY) if good else None


def pose_of_text(text: str, convention: str) -> np.ndarray:
    """T_base_flange (4, 4) of a pose as a pendant shows it or somebody types it.

    Parameters
    ----------
    text
        x, y, z in mm and the orientation: angles in degrees, a rotation vector in rad, quaternions, or a matrix. Names of the numbers and
        decimal commas are understood. ``p[..]`` of a Universal Robot is in m and rad, whatever the convention. Sixteen numbers are a 4 x 4
        matrix row by row.
    convention
        Of the orientation, as ``mbcacq.geometry.orientations`` names it.

    Raises
    ------
    ConfigError
        The numbers are no pose.
    """
    ur = text.lstrip().startswith("p[")
    convention = "vector" if ur else convention
    count = 3 + orientations.size(convention)
    # A comma separates, unless only decimal commas give as many numbers as a pose has.
    readings = [_NUMBER.findall(_NAME.sub(" ", text.replace(",", mark))) for mark in (" ", ".")]
    values = np.array(next((found for found in readings if len(found) in (count, 16)), readings[0]), dtype=float)
    try:
        if len(values) == 16 and np.array_equal(values[12:], [0, 0, 0, 1]):
            matrix = values.reshape(4, 4)
            return se3.transform(orientations.to_matrices(matrix[None, :3, :3].reshape(1, 9), "matrix")[0], matrix[:3, 3])
        if len(values) != count:
            raise ValueError(f"{len(values)} numbers, and {count} are expected: x, y, z and {orientations.in_words(convention)}")
        turn = values[3:] if convention in ("vector", "matrix", *orientations.QUATERNIONS) else from_degrees(values[3:])
        if convention == "vector" and np.linalg.norm(turn) > 2 * np.pi + 1e-6:
            raise ValueError("the rotation vector is longer than a whole turn; it is expected in rad")
        return se3.transform(orientations.to_matrices(turn[None], convention)[0], values[:3] * (1e3 if ur else 1.0))
    except ValueError as error:
        raise ConfigError(f"'{text.strip()[:80]}' is no pose: {error}") from None


class TypedPoses:
    """Poses that a person types or pastes, a line each. ask: shows a question and returns the line, None at the end of input."""

    def __init__(self, ask: Callable[[], str | None], convention: str, say: Callable[[str], None]) -> None:
        self._ask, self._convention, self._say = ask, named_convention(convention, "--flange"), say

    def next(self, wait: Waits) -> np.ndarray | str | None:
        """T_base_flange (4, 4), 'n' where the view is out of reach, None at the end."""
        while (line := self._ask()) is not None:
            if (word := line.strip().lower()) in ("n", "no"):
                return "n"
            if word in ("", "q", "end"):
                return None
            try:
                return pose_of_text(line, self._convention)
            except ConfigError as error:
                self._say(str(error))
        return None


class PoseFile:
    """The rows of a table of poses, those that are added later too."""

    def __init__(self, path: Path, options: TableOptions) -> None:
        self._path, self._options, self._row = path, options, 0

    def next(self, wait: Waits) -> np.ndarray | str | None:
        """T_base_flange (4, 4) of the next row; None if none comes."""
        while True:
            table = table_of(self._path, self._options)
            if self._row < len(table):
                self._row += 1
                return self._pose_columns(table).transforms(table)[self._row - 1]
            if not wait():
                return None

    def _pose_columns(self, table: Table) -> PoseHeadings:
        """The columns of the flange's pose. Raises ConfigError if they leave something open: few rows cannot decide it."""
        if (group := flange_group(table)) is None:
            raise ConfigError(f"{self._path}: no pose of the flange in {', '.join(table.columns)}; name x, y, z and its orientation")
        convention, *others = conventions_of(group, self._options.flange, "--flange")
        if others:
            raise ConfigError(f"{self._path}: the headings leave the orientation open; say --flange CONVENTION")
        turns = convention not in ("matrix", *orientations.QUATERNIONS)
        if group.length is None or (turns and group.angle is None):
            raise ConfigError(f"{self._path}: the headings {', '.join(group.names)} lack units; write such as x_mm and rx_deg")
        return replace(group, convention=convention, alternatives=())


class FollowedArm:
    """The joint angles of an arm that others move, each time that it stands at another place."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._last: np.ndarray | None = None

    def next(self, wait: Waits) -> np.ndarray | str | None:
        """(n,) rad; None if the arm does not move on."""
        rest = self._robot.state()
        while True:
            now = self._robot.state()
            if now.moving or np.abs(now.q - rest.q).max() > STILL:
                rest = now
            elsewhere = self._last is None or np.abs(now.q - self._last).max() > MOVED
            if elsewhere and now.time_s - rest.time_s >= STOOD_S:
                self._last = now.q
                return now.q
            if not wait():
                return None


@contextmanager
def followed_arm(plan: Path) -> Iterator[tuple[Any, FollowedArm]]:
    """The arm of a plan, connected, never moved, as (RobotModel, source of poses). Raises ConfigError if the plan may move it."""
    loaded = load(plan)
    if loaded.plan.robot.follow is None:
        raise ConfigError(f"{plan}: its arm is moved by this program; for --follow the plan has follow: {{}} below robot")
    with device_makers(loaded)["robot"]() as robot:
        yield loaded.cell.robot, FollowedArm(robot)
