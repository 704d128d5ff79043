"""The parts of ``mbcacq.diagnose``: one recording of poses, several, motion; what was learnt tried elsewhere; where it comes from."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy

from mbcacq.calibration.calibrate import calibrate, calibrate_with_effects, effects_fitted_with_the_cell
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.description import likely_cause_named
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.calibration.transfer import Transfer, check_transfer
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.executor import cores
from mbcacq.diagnosis.given_effects import PosesGiven, evidence_given
from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError, ConfigError, MbcacqError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.cell import RobotModel
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.recording.datasets.trajectory_set import is_trajectory_set
from mbcacq.version import __version__
from mbcacq.workflow.diagnosis_document import FileRead, Provenance
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.load import as_observations, as_trajectories, is_run_folder, recorded_moves

Data = Observations | Trajectory | Path | str
Trial = Callable[[CalibratedCell, CalibratedCell], Transfer]  # of a calibrated cell, and of one that geometry alone gave


@dataclass(frozen=True, kw_only=True)
class Question:
    """How to diagnose, as ``mbcacq.diagnose`` takes it. check: recordings that take no part."""

    progress: Callable[[str], None] = lambda text: None
    workers: int | None = None
    options: CalibrationOptions | None = None
    check: tuple[Data, ...] = ()
    place: str = "fitted"
    minutes: float | None = OPTIONS.minutes


def diagnose_together(data: Sequence[Data], how: Question) -> DiagnosisResult:
    """Several recordings of one arm, as one problem; their trajectories, where there are some, together as well. Raises ConfigError."""
    motions = as_trajectories([one for one in data if is_trajectory(one) and not isinstance(one, Observations)])
    recordings = [as_observations(one) for one in data if not is_trajectory(one) and not isinstance(one, Trajectory)]
    for motion in motions:
        refuse_motion_of_other_arm(recordings[0].cell.robot, motion.robot)
    if len(recordings) == 1:
        found = diagnose_poses(recordings[0], how)
    else:
        with likely_cause_named(recordings[0]):
            poses = diagnose(recordings, progress=how.progress, workers=how.workers or cores(), options=how.options, minutes=how.minutes)
        found = DiagnosisResult(poses=poses)
    if motions:
        how.progress("comparing the motion")
        found = with_motion(found, diagnose_motion(motions, how).motion, how)
    return found


def with_motion(found: DiagnosisResult, motion: MotionDiagnosis | None, how: Question) -> DiagnosisResult:
    """The diagnosis of poses with that of a motion. The poses are searched again with what the motion is sure of; what both decide is
    kept.
    """

    if found.poses is None or found.observations is None or motion is None:
        return replace(found, motion=motion)
    how.progress("searching the poses again, with what the motion shows")
    try:
        searched = evidence_given(found.observations, PosesAndMotion(found.poses, motion).given_by_motion, how.options)
    except CalibrationError:  # poses that do not determine the cell with it say nothing more
        searched = None
    if searched is None:
        return replace(found, motion=motion)
    return _with_effects_of_both(replace(found, motion=motion, given_motion=searched.evidence), searched)


def _with_effects_of_both(found: DiagnosisResult, searched: PosesGiven) -> DiagnosisResult:
    """The diagnosis whose model has the effects that poses and motion decided together, if they decided any."""
    both = None if found.both is None else found.both.together
    model = searched.model(both.sets[0].effects) if both is not None and both.decided and both.significant else None
    if model is None or found.poses is None or found.observations is None:
        return found
    fitted, notes = fitted_model(found.observations, model)
    kept = "the effects that are kept are those of poses and motion together; what the motion determines is held where the cell is fitted"
    return replace(found, poses=replace(found.poses, model=fitted, notes=(*found.poses.notes, *notes, kept)))


def refuse_motion_of_other_arm(poses: RobotModel, motion: RobotModel) -> None:
    """Raises ConfigError where the nominal links of the arm that moves are others than those of the arm of the poses. A name is no reason:
    a controller and a cell file may call one arm differently."""
    if motion.n != poses.n or not motion.chain.same_links(poses.chain):
        raise ConfigError(
            f"the poses are of '{poses.name}' ({poses.n} axes) and the motion is of '{motion.name}' ({motion.n} axes), whose nominal links "
            "are others; diagnose them one after the other, or give both the same robot file"
        )


def to_be_checked(learnt: Observations, others: Sequence[Data], place: str) -> list[tuple[str, Trial]]:
    """The trials on other recordings, with their names; these are read beforehand, so that a wrong one costs no diagnosis.

    Raises ConfigError where one cannot be read or is of another arm.
    """
    out = []
    for other in others:
        if isinstance(other, Trajectory):
            continue
        name = "" if isinstance(other, Observations) else str(other)
        recording, robot = as_observations(other), learnt.cell.robot
        refuse_other_arm("what is learnt is of", robot.name, robot.chain, recording.cell.robot, name or "the other recording")
        out.append((name, trial_on(recording, name, place)))
    return out


def trial_on(recording: Observations, name: str, place: str) -> Trial:
    """The trial on another recording."""
    return lambda cell, alone: check_transfer(recording, cell, alone.state.chain, place=place, recording=name)


def checked(
    learnt: Observations, found: DiagnosisResult, others: Sequence[tuple[str, Trial]], progress: Callable[[str], None]
) -> DiagnosisResult:
    """What was found in a recording, calibrated there once and tried on the others. The diagnosis keeps the effects as they were tried. A
    trial that fails is a note of the diagnosis, which stays.

    others: with their names.
    """

    options = CalibrationOptions(refuse=False)
    progress("calibrating with what was found")
    try:
        alone = calibrate(learnt, replace(options, discrepancy=False, random_links=False))
        cell = calibrate_with_effects(learnt, options, found.model) if found.model else alone
    except Exception as error:  # noqa: BLE001 -- whatever it is, the diagnosis is not lost for it
        return with_note(found, f"what was found was tried on no other recording, as the cell cannot be calibrated with it: {said(error)}")
    checks = []
    for name, other in others:
        progress(f"trying it on {name or 'the other recording'}")
        try:
            checks.append(other(cell, alone))
        except Exception as error:  # noqa: BLE001 -- whatever it is, the diagnosis is not lost for it
            found = with_note(found, f"what was found could not be tried on {name or 'the other recording'}: {said(error)}")
    if found.poses is not None and cell.effects is not None:
        found = replace(found, poses=replace(found.poses, model=cell.effects))
    return replace(found, checks=tuple(checks))


def with_note(found: DiagnosisResult, note: str) -> DiagnosisResult:
    """The same diagnosis with one note more."""
    return found if found.poses is None else replace(found, poses=replace(found.poses, notes=(*found.poses.notes, note)))


def said(error: Exception) -> str:
    """The text of an error; one that is not for users has its kind as well."""
    return str(error) if isinstance(error, MbcacqError) else f"unexpected {type(error).__name__}: {error}; please report it"


def provenance(data: Data, check: Sequence[Data], options: dict[str, Any]) -> Provenance:
    """Where a diagnosis comes from: files with their SHA-256, versions of the programs, options."""

    return Provenance(
        recording=str(data) if isinstance(data, Path | str) else "",
        files=tuple(one for source in (data, *check) if isinstance(source, Path | str) for one in _hashed(Path(source))),
        versions={"mbcacq": __version__, "numpy": numpy.__version__, "python": platform.python_version()},
        options=options,
    )


def _hashed(source: Path) -> list[FileRead]:
    """Name, size and SHA-256 of a recording: of the files of an observation set or the parts of a run, not of its clouds."""

    wanted = {".csv", ".yaml", ".rrd"}
    paths = [source] if source.is_file() else sorted(p for p in source.glob("*") if p.is_file() and p.suffix in wanted)
    out = []
    for path in paths:
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256")
        except OSError:
            continue  # a file that went away meanwhile is not part of what was read
        out.append(FileRead(str(path), path.stat().st_size, digest.hexdigest()))
    return out


def diagnose_motion(
    trajectories: Sequence[Trajectory | Path | str], how: Question, check: Sequence[Trajectory | Path | str] = ()
) -> DiagnosisResult:
    """The diagnosis of trajectories of one robot, together. check: further ones, on which what was learnt is tried.

    Raises ConfigError where they do not fit together.
    """
    from mbcacq.diagnosis.motion.diagnose import check_trajectories, diagnose_trajectories

    learnt, others = as_trajectories(trajectories), as_trajectories(check)
    found = diagnose_trajectories(learnt, minutes=how.minutes)
    if others:
        names = ["" if isinstance(one, Trajectory) else str(one) for one in check]
        found = replace(found, checks=check_trajectories(learnt, list(zip(names, others, strict=True))))
    return DiagnosisResult(motion=found)


def diagnose_poses(observations: Observations, how: Question, *, formulas: bool = False, fitted: bool = True) -> DiagnosisResult:
    """The diagnosis of poses at standstill. fitted: whether the effects are fitted together with the cell. Raises CalibrationError."""
    refit = partial(fitted_model, observations) if fitted else None
    with likely_cause_named(observations):
        found = diagnose(
            observations,
            progress=how.progress,
            workers=how.workers or cores(),
            options=how.options,
            formulas=formulas,
            refit=refit,
            minutes=how.minutes,
        )
    return DiagnosisResult(poses=found, observations=observations)


def fitted_model(observations: Observations, model: EffectModel) -> tuple[EffectModel | None, tuple[str, ...]]:
    """The effects of a diagnosis fitted together with the cell, as a calibration would fit them. They stay as the diagnosis had them if the
    recording does not determine the cell with them; a sentence says why.
    """

    try:
        return effects_fitted_with_the_cell(observations, CalibrationOptions(refuse=False), model), ()
    except CalibrationError as reason:
        return model, (f"the effects could not be fitted with the cell: {reason}",)


def combined_with_motion(found: DiagnosisResult, recording: Path, how: Question) -> DiagnosisResult:
    """The diagnosis of the poses with that of the motion between them, where a run recorded torques or joint-side angles."""
    if not (is_run_folder(recording) or recording.suffix == ".rrd"):
        return found
    try:
        stretches = recorded_moves(recording)
    except ConfigError:
        return found
    if not stretches:
        return found
    from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories  # here, for it imports scipy.signal, which is slow

    how.progress("comparing the motion between the poses")
    return with_motion(found, diagnose_trajectories(stretches, minutes=how.minutes), how)


def is_trajectory(data: Data) -> bool:
    return isinstance(data, Trajectory) or (isinstance(data, Path | str) and is_trajectory_set(data))
