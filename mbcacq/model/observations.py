"""The observation set as arrays: what was measured, ready for a solver. Reading and writing it is in ``recording``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.model.board_images import BoardImages
from mbcacq.model.cell import Cell


@dataclass(frozen=True)
class Observations:
    """P poses of an n-axis arm and M measured centres. A column that the recording lacks is None.

    Attributes
    ----------
    cell
        Arm, scanner, artefacts and stations.
    pose_id : (P,) ndarray
        Number of each pose.
    station : (P,) ndarray
        Index into ``cell.stations``.
    q : (P, n) ndarray
        Joint angles as reported at standstill, rad.
    pose : (M,) ndarray
        Index of the pose of each centre, non-decreasing.
    ball : (M,) ndarray
        Index into ``cell.ball_ids``.
    xyz : (M, 3) ndarray
        Centres in the frame of the scanner, or of the instrument, mm.
    phase : (P,) ndarray or None
        Phase of the plan, '' if not known.
    time_s : (P,) ndarray or None
        Time of each pose, s.
    direction : (P, n) ndarray or None
        Last direction of rotation of each joint: -1, 0 or 1.
    movement : (P, n) ndarray or None
        Rotation from the pose measured before, rad, where directions are not recorded.
    torque : (P, n) ndarray or None
        N m.
    current : (P, n) ndarray or None
        Motor currents.
    payload_kg : (P,) ndarray or None
        Payload, kg.
    velocity : (P, n) ndarray or None
        Joint velocities at the exposure, rad/s.
    sensor_time_s : (P,) ndarray or None
        Time by the scanner's own clock, s, where it measured in motion.
    flange_velocity : (P, 6) ndarray or None
        Velocity of the flange at the exposure in its own frame, mm/s and rad/s, where the scanner measured in motion.
    temperatures
        Name of the column (ends in _C) -> (P,) °C.
    n_points, rms_mm : (M,) ndarray or None
        Number of points of each sphere fit, and its rms, mm.
    rotation : (M, 3, 3) ndarray or None
        Orientation of a 6-dof target.
    covariance : (M, R, R) ndarray or None
        Covariance that each measurement states: of a point (R = 3, mm^2), or of a target's pose (R = 6: position and rotation vector in the
        instrument's frame, mm^2, mm rad, rad^2).
    shared : (M, R, K) ndarray or None
        Change of each measurement by one standard deviation of each of K errors that all measurements share, such as those of a camera's
        intrinsics, mm and rad.
    scale
        Factor by which all measurements were multiplied so that a known length comes out as known; None: the instrument's scale is kept.
    recording : (P,) ndarray or None
        Recording of each pose, where several recordings of one arm are taken as one.
    noise_scale : (P, 3 + n) ndarray or None
        Sigma of a centre's coordinates and of each joint, relative to those of the first recording.
    payload_com : (P, 3) ndarray or None
        Centre of gravity of the payload in the flange frame, mm.
    images : BoardImages or None
        The images from which the observations were made.
    extra
        Columns that this program does not know, kept for a loss-free way out ('poses.NAME' or 'centres.NAME' -> array of str).
    understood
        How a table without a description was read, a sentence for each choice.
    cell_yaml
        The text from which the cell was read, with its comments; '' if it was not read from a file.
    """

    cell: Cell
    pose_id: np.ndarray
    station: np.ndarray
    q: np.ndarray
    pose: np.ndarray
    ball: np.ndarray
    xyz: np.ndarray
    phase: np.ndarray | None = None
    time_s: np.ndarray | None = None
    direction: np.ndarray | None = None
    movement: np.ndarray | None = None
    torque: np.ndarray | None = None
    current: np.ndarray | None = None
    payload_kg: np.ndarray | None = None
    velocity: np.ndarray | None = None
    sensor_time_s: np.ndarray | None = None
    flange_velocity: np.ndarray | None = None
    temperatures: Mapping[str, np.ndarray] = field(default_factory=dict)
    n_points: np.ndarray | None = None
    rms_mm: np.ndarray | None = None
    rotation: np.ndarray | None = None
    covariance: np.ndarray | None = None
    shared: np.ndarray | None = None
    scale: float | None = None
    recording: np.ndarray | None = None
    noise_scale: np.ndarray | None = None
    payload_com: np.ndarray | None = None
    images: BoardImages | None = None
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    understood: tuple[str, ...] = ()
    cell_yaml: str = ""

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.q)

    @property
    def n_centres(self) -> int:
        """Number of measured centres M."""
        return len(self.xyz)

    @property
    def width(self) -> int:
        """Number of rows of one measurement: 3 of a point, 6 of a target's pose, 1 of a distance."""
        return 1 if self.cell.length_scale else 3 if self.rotation is None else 6

    @property
    def n_recordings(self) -> int:
        """Number of recordings that are taken as one."""
        return 1 if self.recording is None else int(self.recording.max(initial=0)) + 1

    @property
    def measuring_order(self) -> np.ndarray:
        """(P,) poses in the order of measuring: of time, where it was recorded."""
        return np.argsort(np.arange(self.n_poses) if self.time_s is None else self.time_s, kind="stable")

    @property
    def shows_target_orientation(self) -> bool:
        """For an external instrument: whether the target's orientation shows, measured or by several reflectors at different places."""
        return self.rotation is not None or bool(np.ptp(self.cell.ball_centres[np.unique(self.ball)], axis=0).max(initial=0.0) > 1e-6)

    def select(self, keep: np.ndarray) -> Observations:
        """Some of the poses with their centres; stations and balls keep their indices.

        Parameters
        ----------
        keep : (P,) ndarray
            bool, whether each pose is kept.

        Returns
        -------
        Observations
            The poses that are kept.
        """
        keep = np.asarray(keep, dtype=bool)
        rows = keep[self.pose]
        renumber = np.cumsum(keep) - 1
        by_pose = {name: _take(getattr(self, name), keep) for name in POSE_COLUMNS}
        by_centre = {name: _take(getattr(self, name), rows) for name in CENTRE_COLUMNS}
        by_centre["pose"] = renumber[self.pose[rows]]
        extra = {k: v[keep if k.startswith("poses.") else rows] for k, v in self.extra.items()}
        temperatures = {k: v[keep] for k, v in self.temperatures.items()}
        return replace(self, **by_pose, **by_centre, extra=extra, temperatures=temperatures)

    def measured(self) -> Observations:
        """The poses with at least one centre: only these say anything about a cell.

        Returns
        -------
        Observations
            The same object if all poses have centres.
        """
        seen = np.bincount(self.pose, minlength=self.n_poses) > 0
        return self if seen.all() else self.select(seen)


POSE_COLUMNS = (
    "pose_id", "station", "q", "phase", "time_s", "direction", "movement", "torque", "current", "payload_kg", "velocity",
    "sensor_time_s", "flange_velocity",
    "recording", "noise_scale", "payload_com",
)  # fmt: skip
CENTRE_COLUMNS = ("pose", "ball", "xyz", "n_points", "rms_mm", "rotation", "covariance", "shared")


def _take(array: np.ndarray | None, mask: np.ndarray) -> np.ndarray | None:
    return None if array is None else array[mask]
