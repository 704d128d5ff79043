"""The whole job: a plan executed, recorded, calibrated and verified."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.acquisition.device_check import refuse_impossible_devices, refuse_unattended
from mbcacq.acquisition.event_bus import Subscriber
from mbcacq.acquisition.runner import Pause
from mbcacq.design.planned_scope import scope_sentence
from mbcacq.devices.addresses import on_loopback_only
from mbcacq.errors import ConfigError, ConnectError, IdentityError
from mbcacq.plan import LoadedPlan, PlannedPose, expand, refuse_errors
from mbcacq.plan.motion_preview import Swept
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.register import RunKind, kind_of
from mbcacq.workflow import resume as resuming
from mbcacq.workflow.acquire import Acquisition, new_run_folder, plan_acquisition
from mbcacq.workflow.address_space import refuse_small_address_space
from mbcacq.workflow.corrected_targets import CalibratedArm, CorrectedTargets, corrected_targets, to_go_on_with
from mbcacq.workflow.dry_run import MeasuredBefore, device_overrides, name_of
from mbcacq.workflow.evaluate import RunResult, evaluate
from mbcacq.workflow.load import as_plan, load_observations


def refuse_motion(loaded: LoadedPlan, poses: Sequence[PlannedPose], sweep: Swept) -> None:
    """Refuse to move a real arm: nobody said that it may. A robot at this computer's loopback addresses can only be a fake. Raises
    ConfigError."""
    if not on_loopback_only(loaded.plan.robot.options):
        raise ConfigError(
            f"this would move {loaded.cell.robot.name}: {len(poses)} poses, the scanner at up to {sweep.speed_mm_s:.0f} mm/s; "
            "give an operator whose allow_motion agrees, or dry_run=True"
        )


@dataclass(frozen=True, kw_only=True)
class Operator:
    """Who is asked and informed during a run; the default moves no real arm.

    Attributes
    ----------
    allow_motion
        Called with plan, remaining poses and swept space before a real arm moves; raises Aborted or ConfigError to refuse.
    artefact_moved
        Called in a resumed run with a station; returns whether its artefact was touched since.
    pause
        Asked before each pose.
    message
        Called with sentences for people.
    progress
        Called with a sentence at the begin of each step that takes long, and with an empty one if the terminal is needed otherwise.
    subscribers
        Get every event.
    assume_yes
        Answer the positioner's prompts with yes.
    began
        Called with the folder of the run before anything is opened.
    """

    allow_motion: Callable[[LoadedPlan, Sequence[PlannedPose], Swept], None] = refuse_motion
    artefact_moved: Callable[[str], bool] = lambda station: False
    pause: Pause | None = None
    message: Callable[[str], None] = lambda sentence: None
    progress: Callable[[str], None] = lambda sentence: None
    subscribers: tuple[Subscriber, ...] = ()
    assume_yes: bool = False
    began: Callable[[Path], None] = lambda folder: None

    def allow(self, acquisition: Acquisition) -> None:
        """Ask before a real arm moves to the poses that remain. Nothing moves an arm that is only followed, so nobody is asked about it.

        Parameters
        ----------
        acquisition
            What is about to be measured.

        Raises
        ------
        ConfigError
            A device must ask a person who is not there. This is examined last.
        """
        loaded = acquisition.loaded
        if loaded.plan.robot.follow is None:
            remaining = [p for p in acquisition.poses if p.number not in acquisition.done]
            self.allow_motion(loaded, remaining, acquisition.sweep())
        try:
            refuse_unattended(loaded, self.assume_yes)
        except ConfigError as error:
            if not on_loopback_only(loaded.plan.robot.options):
                raise
            raise ConfigError(f"{error}; the plan's robot is on this computer, a fake: --dry-run takes the whole fake cell") from error


def allowed_acquisition(
    operator: Operator, loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int], part: int, dry_run: bool, seed: int
) -> Acquisition:
    """The checked path to the poses that remain, once a real arm may move along it. seed: of the fake cell in a dry run.

    Raises what ``plan_acquisition`` and ``allow`` raise.
    """
    operator.progress("checking every motion between the poses")
    acquisition = plan_acquisition(loaded, poses, done, part, name_of(dry_run, seed))
    acquisition.simulated = dry_run or on_loopback_only(loaded.plan.robot.options)
    operator.progress("")
    if not dry_run:
        operator.allow(acquisition)
    operator.progress("starting the fake cell" if dry_run else "")
    return acquisition


def run(  # noqa: PLR0913 -- the whole job: one argument an option of its command
    plan: LoadedPlan | Path | str,
    *,
    dry_run: bool = False,
    out: Path | str | None = None,
    resume: Path | str | None = None,
    measure_again: bool = False,
    live: bool = False,
    seed: int = 0,
    operator: Operator | None = None,
    corrected: CalibratedArm | None = None,
) -> RunResult:
    """Execute a plan, record it, calibrate the cell and verify it. The files are in the folder of the run.

    Parameters
    ----------
    plan
        The plan, or its file.
    dry_run
        Run against the fake cell of ``seed``, on this computer.
    out
        The folder of the run (default runs/TIME_NAME).
    resume
        Go on with this folder; poses that were measured already are skipped.
    measure_again
        With ``resume``: measure again the poses at partly measured stations.
    live
        Serve the recording on 127.0.0.1 while it grows.
    seed
        Seed of the fake cell.
    operator
        Who allows a real arm to move, and is asked and informed.
    corrected
        A calibrated arm with its effects, whose model steers: with the joint angles of every pose, that arm stands where the plan means it
        to. A resumed run keeps the targets that it began with.

    Returns
    -------
    RunResult
        The calibrated and verified cell with its files.

    Raises
    ------
    ConfigError
        The plan or the options cannot be executed.
    SafetyStop
        The arm was stopped. A device's own errors are raised as they are.
    CalibrationError
        The recording cannot be calibrated.
    RecordingError
        The recording cannot be written, or another process writes in the folder.
    SystemRefused
        The computer lacks memory, a file or a right.
    """
    if resume is not None and out is not None:
        raise ConfigError("--resume and --out exclude each other: a resumed run goes on in its own folder")
    refuse_small_address_space()
    operator = operator or Operator()
    loaded = as_plan(plan)
    if not dry_run:
        refuse_impossible_devices(loaded)
    operator.progress("checking that every pose can be reached and seen")
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    operator.progress("")
    if sentence := scope_sentence(loaded, poses):
        operator.message(sentence)
    cell, folder = name_of(dry_run, seed), None if resume is None else Path(resume)
    with ExitStack() as held:
        if folder is not None and folder.is_dir():
            held.enter_context(write_lock(folder, "run --resume"))
        before = resuming.progress_before(folder, loaded, cell, operator.message)
        targets = _targets(loaded, poses, corrected, folder, dry_run, operator)
        poses = poses if targets is None else targets.steer(poses)
        done = resuming.poses_to_skip(loaded, poses, before, operator.artefact_moved, measure_again)
        if folder is not None and all(pose.number in done for pose in poses):
            operator.message(f"all {len(poses)} poses were measured already; nothing moves")
            return evaluate(folder, loaded.plan.accept.sphere_spacing_error_mm, operator.progress)
        acquisition = allowed_acquisition(operator, loaded, poses, done, before.part, dry_run, seed)
        acquisition.corrected, acquisition.kind = targets, _kind(loaded, folder)
        try:
            known = MeasuredBefore.of(load_observations(folder), done) if dry_run and done and folder is not None else None
            with device_overrides(loaded, poses, dry_run, seed, operator.assume_yes, known) as overrides:
                if folder is None:
                    folder = new_run_folder(None if out is None else Path(out), loaded.path.stem)
                    held.enter_context(write_lock(folder, "run"))
                acquisition.folder = folder
                operator.began(folder)
                acquisition.execute(overrides, operator.subscribers, live=live, message=operator.message, pause=operator.pause)
        except ConnectError as error:
            raise _with_fakes_named(error, loaded, dry_run) from error
        return evaluate(folder, loaded.plan.accept.sphere_spacing_error_mm, operator.progress)


def _kind(loaded: LoadedPlan, resumed: Path | None) -> RunKind:
    """What is recorded: a resumed run stays what it was, and becomes an extension with the poses of another plan."""
    kind = RunKind.RUN if resumed is None else kind_of(resumed)
    return RunKind.EXTENSION if kind is RunKind.RUN and loaded.grown_from is not None else kind


def _targets(
    loaded: LoadedPlan, poses: list[PlannedPose], calibrated: CalibratedArm | None, folder: Path | None, dry_run: bool, operator: Operator
) -> CorrectedTargets | None:
    """The targets of a run that a calibrated arm steers, checked like those of the plan: limits, clearances, fields of view. folder: of the
    run that goes on, or None."""
    if calibrated is None and folder is None:
        return None
    operator.progress("correcting the targets by the calibrated arm" if calibrated is not None else "")
    targets = None if calibrated is None else corrected_targets(loaded, poses, calibrated, dry_run)
    targets = targets if folder is None else to_go_on_with(folder, targets)
    if targets is not None:
        refuse_errors(loaded, targets.steer(poses))
        operator.message(
            f"the targets of {len(poses)} poses are corrected: by the model the nominal arm would miss their places by "
            f"{np.sqrt(np.mean(targets.moved_mm**2)):.3f} mm rms, up to {targets.moved_mm.max():.3f} mm"
        )
    operator.progress("")
    return targets


def _with_fakes_named(error: ConnectError, loaded: LoadedPlan, dry_run: bool) -> ConnectError:
    """The error, with what to do besides where the plan's robot can only be a fake that was not started."""
    if dry_run or isinstance(error, IdentityError) or not on_loopback_only(loaded.plan.robot.options):
        return error
    return ConnectError(
        f"{error}; without hardware: mbcacq run {loaded.path} --dry-run, or start the fake cell in another terminal first: "
        f"mbcacq fakes {loaded.path}"
    )
