"""How far an arm misses the places that it is sent to, as its own scanner measures it: before and after its targets were corrected.

Targets of an arm are given by its nominal model. So the hand-eye transform and the stations are adjusted to a recording as if the arm stood
exactly where it was sent, and nothing else: what remains at the balls is what the arm misses. With the joint angles as driven, it is the
error of the arm of the controller's model (before). With the joint angles by which the places were planned, it is the error of the arm with
corrected targets (after). Both are of the same poses, of one recording, by one procedure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation.adjustment import as_it_is
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.solver import solve
from mbcacq.model.json_text import AsJson
from mbcacq.model.observations import Observations
from mbcacq.quantities import fixed

FEWEST = 4  # poses of a station: with fewer, its adjusted place takes up most of what the arm misses there


@dataclass(frozen=True)
class MissedBy:
    """mm, over poses: rms, median and largest of what an arm misses."""

    rms_mm: float
    median_mm: float
    max_mm: float

    @classmethod
    def of(cls, mm: np.ndarray) -> MissedBy:
        """Figures of the poses' (P,) mm."""
        return cls(float(np.sqrt(np.mean(mm**2))), float(np.median(mm)), float(mm.max()))


@dataclass(frozen=True)
class ArmImprovement(AsJson):
    """What corrected targets changed, at poses of one recording.

    Attributes
    ----------
    before, after : MissedBy
        Over the poses that count.
    noise_mm : float
        The rms that the scanner and the joints' repeatability alone would leave.
    poses : int
        Number of poses that count.
    new : bool or None
        Whether none of these places took part in the calibration (None: not known).
    pose, before_mm, after_mm
        Number of each pose that counts, and its distance before and after.
    """

    before: MissedBy
    after: MissedBy
    noise_mm: float
    poses: int
    new: bool | None
    pose: tuple[int, ...]
    before_mm: tuple[float, ...]
    after_mm: tuple[float, ...]

    @property
    def where(self) -> str:
        """Which places these are, in words."""
        if self.new is None:
            return "it is not known which of them took part in the calibration"
        return "none of them took part in the calibration" if self.new else "all of them are places that took part in the calibration"

    @property
    def text(self) -> str:
        """The result, as a sentence."""
        before, after, noise = (fixed(mm) for mm in (self.before.rms_mm, self.after.rms_mm, self.noise_mm))
        return (
            f"The arm misses its places by {before} mm rms with its controller's model, by {after} mm with corrected targets "
            f"(noise alone: {noise} mm), at {self.poses} poses; {self.where}."
        )


def arm_improvement(
    observations: Observations, nominal: np.ndarray, corrected: np.ndarray, noise_mm: np.ndarray, took_part: np.ndarray | None
) -> ArmImprovement | None:
    """The change by the targets of a recording with corrected targets.

    nominal, corrected: (P, n) rad, the joint angles that each pose was planned by and those that the arm was sent to. noise_mm: (P,) 3D
    standard deviation of one measured point. took_part: (P,) bool, whether the place took part in the calibration; None: not known. Places
    that the calibration did not measure are judged where there are as many as a station needs, else all. None if no station has enough
    poses. Raises CalibrationError if hand-eye and stations cannot be adjusted.
    """
    measured = np.bincount(observations.pose, minlength=observations.n_poses) > 0
    counts = np.bincount(observations.station[measured], minlength=len(observations.cell.stations))
    enough = measured & (counts[observations.station] >= FEWEST)
    if not enough.any() or observations.cell.robot.of_flange_poses:
        return None
    obs = observations.select(enough)
    planned = replace(obs, q=obs.q + (nominal - corrected)[enough])
    before, after = missed_mm(obs), missed_mm(planned)
    new, counted = None, np.ones(obs.n_poses, bool)
    if took_part is not None:
        elsewhere = ~took_part[enough]
        new = bool(elsewhere.sum() >= FEWEST)
        counted = elsewhere if new else counted
    return ArmImprovement(
        before=MissedBy.of(before[counted]),
        after=MissedBy.of(after[counted]),
        noise_mm=float(np.sqrt(np.mean(noise_mm[enough][counted] ** 2))),
        poses=int(counted.sum()),
        new=new,
        pose=tuple(obs.pose_id[counted].tolist()),
        before_mm=tuple(before[counted].tolist()),
        after_mm=tuple(after[counted].tolist()),
    )


def missed_mm(obs: Observations) -> np.ndarray:
    """(P,) mm: how far the arm is from where its nominal model says it stands, rms over the balls of each pose.

    Hand-eye and stations are adjusted by plain least squares, from the calibration of the hand-eye alone: weights that take what the arm
    misses for noise of its joints would leave more of it.
    """
    phases = None if obs.phase is None else tuple(np.unique(obs.phase).tolist())
    state = calibrate(obs, CalibrationOptions(kinematics=False, refuse=False, robust=False, phases=phases)).state
    anywhere = tuple(replace(s, T_base_station=None) for s in obs.cell.stations)
    free = replace(obs, rotation=None, cell=replace(obs.cell, stations=anywhere))
    away = solve(as_it_is(free, state, hold=False)).residual
    return np.sqrt(np.bincount(obs.pose, np.sum(away**2, axis=1), obs.n_poses) / np.bincount(obs.pose, minlength=obs.n_poses))
