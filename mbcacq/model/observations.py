"""The observation set as arrays: what was measured, ready for a solver. Reading and writing it is in ``recording``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.model.cell import Cell


@dataclass(frozen=True)
class Observations:
    """P poses of an n-axis arm and M measured centres. Optional columns are None when the recording has none.

    Poses: pose_id (P,) int; station (P,) index into ``cell.stations``; q (P, n) rad as reported at standstill; phase (P,) str
    ('' unknown); time_s (P,); direction (P, n) in {-1, 0, 1}; movement (P, n) rad, from the
    pose measured before, where directions are not recorded; torque (P, n) N m; current (P, n); payload_kg (P,);
    velocity (P, n) rad/s at the exposure; temperatures: column name (ends in _C) -> (P,) deg C.
    Centres: pose (M,) index into the poses, non-decreasing; ball (M,) index into ``cell.ball_ids``; xyz (M, 3) mm in the
    scanner frame (or the instrument's); n_points (M,); rms_mm (M,); rotation (M, 3, 3) orientation of a 6-dof target.
    Where several recordings of one arm are taken as one: recording (P,) int, the recording of each pose; noise_scale (P, 3 + n), sigma of a
    centre's coordinates and of each joint in that recording, relative to the first one's; payload_com (P, 3) mm in the flange frame.
    covariance (M, R, R), where each measurement states its own: of a point (R = 3, mm^2), or of a target's pose (R = 6: position and
    rotation vector in the instrument's frame, mm^2, mm rad, rad^2).
    scale: by which all measurements were multiplied so that a known length comes out as known; None: the instrument's scale is kept.
    extra: columns this program does not know, kept for a loss-free way out ('poses.NAME' or 'centres.NAME' -> array of str).
    cell_yaml: the text the cell was read from, with its comments; '' if it was not read from a file.
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
    temperatures: Mapping[str, np.ndarray] = field(default_factory=dict)
    n_points: np.ndarray | None = None
    rms_mm: np.ndarray | None = None
    rotation: np.ndarray | None = None
    covariance: np.ndarray | None = None
    scale: float | None = None
    recording: np.ndarray | None = None
    noise_scale: np.ndarray | None = None
    payload_com: np.ndarray | None = None
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_yaml: str = ""

    @property
    def n_poses(self) -> int:
        return len(self.q)

    @property
    def n_centres(self) -> int:
        return len(self.xyz)

    @property
    def n_recordings(self) -> int:
        return 1 if self.recording is None else int(self.recording.max(initial=0)) + 1

    @property
    def shows_target_orientation(self) -> bool:
        """For an external instrument: whether the target's orientation shows, measured or by several reflectors at different places."""
        return self.rotation is not None or bool(np.ptp(self.cell.ball_centres[np.unique(self.ball)], axis=0).max(initial=0.0) > 1e-6)

    def select(self, keep: np.ndarray) -> Observations:
        """The poses where ``keep`` (P,) bool holds, with their centres; stations and balls keep their indices."""
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
        """The poses with at least one centre: the only ones that say anything of a cell."""
        seen = np.bincount(self.pose, minlength=self.n_poses) > 0
        return self if seen.all() else self.select(seen)


POSE_COLUMNS = (
    "pose_id", "station", "q", "phase", "time_s", "direction", "movement", "torque", "current", "payload_kg", "velocity",
    "recording", "noise_scale", "payload_com",
)  # fmt: skip
CENTRE_COLUMNS = ("pose", "ball", "xyz", "n_points", "rms_mm", "rotation", "covariance")


def _take(array: np.ndarray | None, mask: np.ndarray) -> np.ndarray | None:
    return None if array is None else array[mask]
