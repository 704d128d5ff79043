"""A hand-eye calibration while it is measured: after each view, how well the camera's place is known and where the next view should be."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbcacq.calibration.calibrate import calibrate
from mbcacq.camera.adjustment import LEAST_IMAGES, AdjustedImages, BoardView, adjust_images
from mbcacq.camera.board import Board
from mbcacq.camera.intrinsics import Intrinsics, opencv
from mbcacq.camera.next_view import NextView, next_view
from mbcacq.errors import MbcacqError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.files.atomic_write import write_file
from mbcacq.files.table import Table
from mbcacq.files.template import filled
from mbcacq.geometry import se3
from mbcacq.model.board_images import BoardImage
from mbcacq.model.cell import TARGET_IN_BASE, Measurement, RobotModel
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees, uncertainty
from mbcacq.recording.datasets import quaternions
from mbcacq.recording.datasets.columns_of_joints import text_of_joints
from mbcacq.recording.datasets.csv_columns import numbers
from mbcacq.recording.datasets.image_set import ImageViews, observations_of_views
from mbcacq.recording.datasets.loose_table import LEAST_POSES, TableOptions
from mbcacq.recording.datasets.observation_set import write_observation_set

FEWEST_VIEWS = 8  # before a standard deviation that was estimated from these views alone counts as known
FLANGE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
TITLES = ("x", "y", "z", "turn about the camera's x", "about y", "about z")
GREEN, BLUE = (60, 180, 40), (220, 120, 20)  # as OpenCV orders colours


@dataclass(frozen=True)
class CameraPlace:
    """T: (4, 4) T_flange_camera, or T_base_camera of a fixed one. U: (6,) expanded uncertainty (k = 2) of the place in mm, along the
    axes of flange or base, and of turns in rad about those of the camera. T_base_board: (4, 4), or T_flange_board of a fixed camera."""

    T: np.ndarray
    U: np.ndarray
    T_base_board: np.ndarray

    def flange_at(self, T_camera_board: np.ndarray, fixed: bool) -> np.ndarray:
        """T_base_flange (4, 4) at which the camera sees the board so."""
        seen = self.T_base_board @ se3.inverse(self.T @ T_camera_board)
        return se3.inverse(seen) if fixed else seen


@dataclass
class HandEyeSession:
    """The views of a hand-eye calibration, kept in a folder that ``mbcacq data new`` reads as well.

    Attributes
    ----------
    folder
        Gets the images, poses.csv, the page index.html, and at the end the observation set.
    board
        What the images show.
    given
        Intrinsics; None: they are estimated.
    measurement
        A camera on the flange, or a fixed one and the board on the flange.
    enough_mm
        Expanded uncertainty (k = 2) of x, y and z that is asked for.
    robot
        Of joint angles; None where poses of the flange are given.
    """

    folder: Path
    board: Board
    given: Intrinsics | None
    measurement: Measurement
    enough_mm: float
    robot: RobotModel | None = None
    views: list[BoardView] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    missing: list[BoardImage] = field(default_factory=list)
    refused: list[np.ndarray] = field(default_factory=list)
    place: CameraPlace | None = None
    observations: Observations | None = None
    problem: str = ""
    size: tuple[int, int] = (640, 480)
    _picture: np.ndarray | None = None

    @property
    def fixed(self) -> bool:
        """Whether the camera is fixed."""
        return self.measurement == TARGET_IN_BASE

    @property
    def enough(self) -> bool:
        """Whether the place is known as well as was asked for."""
        return self.place is not None and len(self.views) >= FEWEST_VIEWS and bool(np.all(self.place.U[:3] <= self.enough_mm))

    def add(self, grey: np.ndarray, pose: np.ndarray) -> str:
        """Take a view, and say what it changed.

        Parameters
        ----------
        grey
            (H, W) uint8.
        pose
            T_base_flange (4, 4) in mm, or joint angles (n,) rad.
        """
        number = len(self.views) + len(self.missing) + 1
        name = f"view{number}.png"
        size = (grey.shape[1], grey.shape[0])
        if self.views and size != self.size:
            return f"view {number}: {size[0]} x {size[1]} px, and those before have {self.size[0]} x {self.size[1]}; it is left out"
        self.size = size
        found = self.board.find(grey)
        self._picture = self._drawn(grey, found)
        if found is None:
            self.missing.append(BoardImage(name=name, reason="the board was not found"))
            counted = f"{self.board.columns}x{self.board.rows}{' inner corners' if self.board.kind == 'chessboard' else ''}"
            return f"view {number}: the board was not found; show all of it, sharp and evenly lit, or correct --size {counted}"
        write_file(self.folder / "images" / name, opencv().imencode(".png", grey)[1].tobytes(), folder=self.folder)
        self.take(BoardView(name, *found), pose)
        write_file(self.folder / "poses.csv", self._csv())
        return f"view {number}: {len(found[0])} points of the board; {self.known()}"

    def take(self, view: BoardView, pose: np.ndarray) -> None:
        """Add points that were found, and calibrate. pose: as of ``add``."""
        self.views.append(view)
        self.poses.append(pose)
        self._calibrate()

    def known(self) -> str:
        """What is determined, in a clause."""
        if self.place is None:
            return self.problem
        U = self.place.U
        place = ", ".join(f"{name} ± {uncertainty(u)}" for name, u in zip(TITLES, U[:3], strict=False))
        turn = ", ".join(uncertainty(u) for u in in_degrees(U[3:]))
        return f"{place} mm, turns about the camera's axes ± {turn}° (k = 2)" + (f"; {self.problem}" if self.problem else "")

    def next_view(self) -> NextView:
        """Where to look from."""
        lens = self.given or (None if (seen := self._adjusted(None)) is None else seen.intrinsics) or self._rough_lens()
        return next_view(self.board, self.size, lens, self._adjusted(lens), self.refused)

    def flange_at(self, view: NextView) -> np.ndarray | None:
        """T_base_flange (4, 4) of a view; None while the camera's place is not known."""
        return None if self.place is None else self.place.flange_at(view.T, self.fixed)

    def show(self, view: NextView | None, said: str) -> None:
        """Write the page: the last image with the points found, and the outline of the board in the next view."""
        picture = self._picture if self._picture is not None else np.full((*self.size[::-1], 3), 235, np.uint8)
        if view is not None:
            outline = [np.rint(view.outline).astype(np.int32).reshape(-1, 1, 2)]
            picture = opencv().polylines(picture.copy(), outline, True, BLUE, max(2, self.size[0] // 300))
        write_file(self.folder / "view.jpg", opencv().imencode(".jpg", picture)[1].tobytes())
        rows = [] if self.place is None else [
            (name, uncertainty(u), "mm" if k < 3 else "°", k < 3 and u <= self.enough_mm)
            for k, (name, u) in enumerate(zip(TITLES, [*self.place.U[:3], *in_degrees(self.place.U[3:])], strict=True))
        ]  # fmt: skip
        page = Path(__file__).with_name("hand_eye.html.j2")
        text = filled(page, said=said, rows=rows, views=len(self.views), enough=self.enough, limit=self.enough_mm, going=view is not None)
        write_file(self.folder / "index.html", text)

    def finish(self) -> Path | None:
        """Write the observation set of the views, and return its folder; None where the views are too few."""
        if self.observations is None:
            return None
        write_observation_set(self.observations, self.folder / "set")
        return self.folder / "set"

    def _adjusted(self, lens: Intrinsics | None) -> AdjustedImages | None:
        """The views adjusted with a camera that is given, or known from these views where they are enough for that."""
        if not self.views or (lens is None and len(self.views) < LEAST_IMAGES):
            return None
        try:
            return adjust_images(self.board, self.views, self.size, lens)
        except (MbcacqError, np.linalg.LinAlgError):
            return None

    def _rough_lens(self) -> Intrinsics:
        """An ordinary lens, whose focal length is the image's width."""
        return Intrinsics(np.full(2, float(self.size[0])), (np.array(self.size) - 1) / 2, np.zeros(5))

    def _columns(self) -> dict[str, tuple[str, ...]]:
        if self.robot is not None:
            return {name: tuple(text) for name, text in text_of_joints(self.robot, "q", np.array(self.poses)).items()}
        T = np.array(self.poses)
        values = np.c_[T[:, :3, 3], quaternions.from_matrix(T[:, :3, :3])]
        return {name: tuple(numbers(values[:, k])) for k, name in enumerate(FLANGE)}

    def _csv(self) -> str:
        columns = {"image": [view.name for view in self.views], **self._columns()}
        return "\n".join(",".join(row) for row in [tuple(columns), *zip(*columns.values(), strict=True)]) + "\n"

    def _calibrate(self) -> None:
        """The camera's place by the views so far, or why there is none."""
        left = max(LEAST_POSES, 0 if self.given else LEAST_IMAGES) - len(self.views)
        if left > 0:
            self.problem = f"{left} more before anything can be calibrated"
            return
        table = Table(self.folder / "poses.csv", self._columns(), list(range(2, 2 + len(self.views))))
        at = {view.name: self.folder / "images" / view.name for view in self.views}
        seen = ImageViews(self.board, list(self.views), at, list(self.missing), self.size, self.given)
        options = TableOptions(flange="wxyz", measurement=self.measurement, robot=self.robot)
        try:
            self.observations = observations_of_views(seen, table, options).observations
            cell = calibrate(self.observations, CalibrationOptions(kinematics=False))
        except MbcacqError as error:
            self.place = None
            self.problem = f"not determined yet: {error}"
            return
        rejected = sorted({self.observations.images.name_of(one.pose) for one in cell.fit.rejected if self.observations.images})
        self.problem = f"contradicting, and left out: {', '.join(rejected)}" if rejected else ""
        board = cell.state.T_flange_scanner if self.fixed else cell.state.T_base_station[0]
        if self.fixed:
            place, C = cell.state.T_base_station[0], cell.fit.station_covariance[0]
        else:
            rows = [cell.names.index(f"hand_eye.{c}") for c in ("x", "y", "z", "rx", "ry", "rz")]
            place, C = cell.state.T_flange_scanner, cell.covariance[np.ix_(rows, rows)]
        R = place[:3, :3]
        self.place = CameraPlace(place, 2 * np.sqrt(np.r_[np.diag(R @ C[:3, :3] @ R.T), np.diag(C)[3:]]), board)

    def _drawn(self, grey: np.ndarray, found: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
        """(H, W, 3) the image with the points found."""
        cv2 = opencv()
        picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        for u, v in np.rint(found[1]).astype(int).tolist() if found else ():
            cv2.circle(picture, (u, v), max(3, grey.shape[1] // 200), GREEN, -1)
        return picture
