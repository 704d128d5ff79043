"""The poses of a plan steered by a calibrated arm: joint angles that bring it, with its effects, to the places the plan means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.joint_targets import joint_targets
from mbcacq.calibration.place_errors import ArmImprovement, arm_improvement
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.devices.addresses import on_loopback_only
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.model.json_text import Matrix, Vector, as_list, damage, digest, from_fields
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.quantities import DEGREE
from mbcacq.recording.run_folder.run_plan import read_kept_plan
from mbcacq.workflow.load import as_cell, is_run_folder, load_observations

LARGEST_MM = 25.0  # by which an arm in good order may miss a place; the errors of arms as delivered are below 10 mm
SAME_PLACE = 2.0 * DEGREE  # of every joint: nearer, effects of gears aside, an error of the arm is the same
WITH_EFFECTS = "with-effects"  # folder in that of a run, of the result with what its diagnosis found
CalibratedArm = CalibratedCell | dict[str, Any] | Path | str


@dataclass(frozen=True)
class CorrectedTargets:
    """Targets by which the calibrated arm reaches the planned places.

    Attributes
    ----------
    result : str
        SHA-256 of the calibration that steers.
    nominal, corrected : Matrix
        (P, n) rad of all poses of the plan.
    moved_mm : Vector
        (P,) by how much the calibrated arm misses its place with the nominal angles.
    noise_mm : Vector
        (P,) 3D standard deviation of a point measured there.
    took_part : Annotated[ndarray, as_list(list[bool])] or None
        (P,) bool, whether the calibration was made with a pose there; None: not known.
    """

    result: str
    nominal: Matrix
    corrected: Matrix
    moved_mm: Vector
    noise_mm: Vector
    took_part: Annotated[np.ndarray, as_list(list[bool])] | None = None

    def __post_init__(self) -> None:
        count = len(self.nominal)
        of_poses = [self.moved_mm, self.noise_mm, *([] if self.took_part is None else [self.took_part])]
        if self.corrected.shape != self.nominal.shape or any(len(values) != count for values in of_poses):
            raise ValueError("their numbers of poses differ")

    def steer(self, poses: Sequence[PlannedPose]) -> list[PlannedPose]:
        """The poses with their corrected joint angles. Raises ConfigError if they are not those that were corrected."""
        q = np.array([p.q for p in poses])
        if q.shape != self.nominal.shape or not np.allclose(q, self.nominal, rtol=0, atol=1e-9):
            raise ConfigError("the corrected targets are of other poses than the plan has; start a new run")
        return [replace(pose, q=corrected) for pose, corrected in zip(poses, self.corrected, strict=True)]

    def improvement(self, obs: Observations) -> ArmImprovement | None:
        """Before and after, as a recording with these targets shows them; None if it cannot."""
        at = obs.pose_id
        if at.max(initial=-1) >= len(self.nominal):
            return None
        took_part = None if self.took_part is None else self.took_part[at]
        try:
            return arm_improvement(obs, self.nominal[at], self.corrected[at], self.noise_mm[at], took_part)
        except CalibrationError:
            return None


def read_targets(content: Any) -> CorrectedTargets:
    """The corrected targets that a run keeps, from the JSON content of their fields. Raises ConfigError if they are damaged."""
    try:
        return from_fields(CorrectedTargets, content)
    except ValueError as error:
        raise ConfigError(f"the corrected targets of this run are damaged ({damage(error)}); start a new run") from error


def corrected_targets(loaded: LoadedPlan, poses: Sequence[PlannedPose], calibrated: CalibratedArm, dry_run: bool) -> CorrectedTargets:
    """Correct the targets of a plan's poses by a calibrated arm with its effects.

    A simulated calibration steers only fakes. Raises ConfigError if the result is of another arm, holds the nominal arm, or is simulated
    and the arm real. It is also raised if a place cannot be reached within the limits, or if the calibrated arm misses one by more than an
    arm in good order.
    """
    arm = as_cell(calibrated)
    refuse_other_arm("the result is of", arm.robot, arm.nominal, loaded.cell.robot, "the plan")
    refuse_uncalibrated(arm, dry_run or on_loopback_only(loaded.plan.robot.options))
    nominal = np.array([p.q for p in poses])
    goals = loaded.cell.robot.chain.flange(nominal)
    found = joint_targets(arm, goals, nominal, loaded.cell.robot.limits)
    moved_mm = np.linalg.norm(arm.frames(nominal)[:, -1, :3, 3] - goals[:, :3, 3], axis=1)
    for pose, reached, reason, left, moved in zip(poses, found.reached, found.reasons, found.error_mm, moved_mm, strict=True):
        where = f"{loaded.path}:{pose.line}: pose {pose.number} (step '{pose.step_name}', station '{pose.station}')"
        if moved > LARGEST_MM:
            raise ConfigError(
                f"{where}: by this result the arm misses the place by {moved:.1f} mm, more than an arm in good order; "
                "give the result of this arm, in this state"
            )
        if not reached:
            raise ConfigError(
                f"{where}: the calibrated arm stays {left:.3f} mm short of its place, {reason}; move the station or change the view"
            )
    noise_mm = np.sqrt(np.trace(arm.measuring_covariance(nominal, np.zeros((len(nominal), 3))), axis1=1, axis2=2))
    return CorrectedTargets(digest(arm.to_dict()), nominal, found.q, moved_mm, noise_mm, _took_part(calibrated, nominal))


def _took_part(calibrated: CalibratedArm, q: np.ndarray) -> np.ndarray | None:
    """(P,) bool: whether the calibration was made with a pose at joint angles near q (P, n) rad; None if its poses are not known."""
    learnt = None
    if isinstance(calibrated, CalibratedCell):
        learnt = None if calibrated.own_fit is None else calibrated.own_fit.observations.q
    elif isinstance(calibrated, Path | str):
        place = Path(calibrated)
        folder = place if place.is_dir() else place.parent
        folder = folder.parent if folder.name == WITH_EFFECTS else folder
        learnt = load_observations(folder).q if is_run_folder(folder) else None
    if learnt is None:
        return None
    return (np.abs(q[:, None] - learnt[None]).max(axis=2) < SAME_PLACE).any(axis=1)


def refuse_uncalibrated(arm: CalibratedCell, simulated_anyway: bool) -> None:
    """Raises ConfigError for a simulated calibration, unless ``simulated_anyway``, and for an arm that was not calibrated."""
    if arm.simulated and not simulated_anyway:
        raise ConfigError(
            "this calibration is simulated, and a real arm would be corrected or judged by it; "
            "give that of a real arm (or --simulated-anyway for a program, --dry-run for a check)"
        )
    if np.array_equal(arm.state.chain.rows, arm.nominal.rows) and not arm.effects:
        raise ConfigError(
            "this result holds the nominal arm (its hand-eye alone was calibrated), which nothing corrects or checks; "
            "give the result of a calibration of the arm, by joint angles and without --hand-eye-only"
        )


def improvement_of_run(folder: Path, obs: Observations) -> ArmImprovement | None:
    """Before and after, where a calibrated arm steered the run of this folder; None if it did not, or the recording cannot show it."""
    kept = read_kept_plan(folder).corrected
    return None if kept is None else read_targets(kept).improvement(obs)


def to_go_on_with(folder: Path, given: CorrectedTargets | None) -> CorrectedTargets | None:
    """The corrected targets of a run that goes on: those it began with, as its folder or its recordings hold them. given: by this call.
    Raises ConfigError if the two do not belong into one recording."""
    kept = read_kept_plan(folder)
    before = None if kept.corrected is None else read_targets(kept.corrected)
    if given is None or kept.files is None:  # lost in the folder and in its recordings: taken to be as in this run
        return before or given
    if before is None:
        raise ConfigError(f"{folder} was recorded with the plan's own targets; go on without --corrected, or start a new run")
    if before.result != given.result:
        raise ConfigError(f"{folder} was steered by another result; go on without --corrected, which keeps that, or start a new run")
    return before
