"""A check of a calibrated cell: a few poses measured again, by the same runner and gates as a run, and judged with all checks before."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.acquisition.device_check import refuse_impossible_devices
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.devices.addresses import on_loopback_only
from mbcacq.errors import CellChanged, ConfigError, command_line
from mbcacq.interim_check.history import CheckedDay, CheckHistory, read_history
from mbcacq.interim_check.measured_day import fit_stations, refuse_incomplete, residuals_of
from mbcacq.interim_check.on_part import seen_as_points, with_noise, with_points
from mbcacq.interim_check.options import OPTIONS, UsualChanges
from mbcacq.interim_check.planned_check import PlannedCheck, choose_poses, planned_check
from mbcacq.interim_check.shown_figures import shown
from mbcacq.interim_check.verdict import CheckVerdict, verdict_of
from mbcacq.interim_check.words import sentence_of
from mbcacq.model import shipped
from mbcacq.model.json_text import digest, fields_as_json
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand, refuse_errors
from mbcacq.quantities import capitalised
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.register import RunKind, kind_of
from mbcacq.report.sources.check_result import FORMAT, keep_check_result
from mbcacq.report.sources.run_folder import read_run_identity
from mbcacq.report.write import write_check_page
from mbcacq.version import __version__
from mbcacq.workflow.acquire import new_run_folder
from mbcacq.workflow.corrected_targets import refuse_uncalibrated
from mbcacq.workflow.dry_run import device_overrides
from mbcacq.workflow.load import as_plan, as_result, is_run_folder, load_observations
from mbcacq.workflow.part_scenes import scenes_as_observations
from mbcacq.workflow.run import Operator, allowed_acquisition

HISTORY = "check.json"
SAME_ANGLE = 1e-9  # rad: the plan still means the same joint angles


@dataclass(frozen=True)
class CheckSettings:
    """Settings of a check.

    Attributes
    ----------
    poses
        Number of poses of a check.
    standing
        Whether the artefacts stay where they stand from check to check, so that their places are judged too.
    days
        What changes from day to day without a cause.
    folder
        Folder of this check's recording (default runs/TIME_check-NAME).
    part
        Judge by the scans of the plan's part, of which all are repeated; the part's place is not judged. A plan without balls always does.
    """

    poses: int = OPTIONS.poses
    standing: bool = True
    days: UsualChanges = OPTIONS.usual_days
    folder: Path | None = None
    part: bool = False


@dataclass(frozen=True)
class InterimCheck:
    """What a check gave.

    Attributes
    ----------
    verdict
        Whether the cell changed, what, where and since when.
    history
        All checks so far.
    file
        File in which they are kept.
    run
        Folder of this check's recording.
    """

    verdict: CheckVerdict
    history: CheckHistory
    file: Path
    run: Path

    @property
    def changed(self) -> bool:
        """Whether the cell is not as it was."""
        return self.verdict.changed

    @property
    def page(self) -> Path:
        """The page of the check; a run that served as a check keeps its own report."""
        return self.run / ("report.html" if kind_of(self.run) is RunKind.CHECK else "check.html")

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return sentence_of(self.verdict, self.history)

    def to_dict(self) -> dict[str, Any]:
        """JSON content of the check.

        Returns
        -------
        dict
            Format 'mbcacq-check-result/1'; angles in rad.
        """
        times, since, between = [day.time for day in self.history.days], self.verdict.since, self.verdict.between
        day, days = None if since is None else times[since], None if between is None else [times[k] for k in between]
        said = {"format": FORMAT, **fields_as_json(self.verdict), "checks": len(times)}
        said |= {"log_e_by_check": [day.log_e for day in self.history.days], "since": day, "since_between": days}
        undone = [{"label": one.suspect.label, "from": times[one.first], "until": times[one.end]} for one in self.verdict.put_right]
        said |= {"put_right": undone}
        return said | {"before_first_check": since == 0, "files": {"history": str(self.file), "recording": str(self.run)}}

    def next_step(self, result: Path | str, plan: Path, dry_run: bool) -> tuple[str, str]:
        """What to do after this check, and the command for it.

        Parameters
        ----------
        result, plan
            The calibration and the plan of the check.
        dry_run
            Whether the cell is the fake one.

        Returns
        -------
        tuple of str
            In words, and as a command.
        """
        how, name = "--dry-run" if dry_run else "--arm", shipped.plan_name(plan)
        if kind_of(self.run) is RunKind.COLLECTED and not self.changed:
            return "collect the same poses again tomorrow, and judge them", command_line("check", result, name, "--from", "RUN")
        kept = () if self.file == _history_file(result, None) else ("--history", self.file)
        if self.changed:
            return "put right what changed, or calibrate anew", command_line("run", name, how)
        when = "repeat the check now" if self.verdict.near else "check again tomorrow, or after any work on the cell"
        return when, command_line("check", result, name, how, *kept)

    def refuse_changed(self) -> None:
        """Raise an error if the cell changed.

        Raises
        ------
        CellChanged
            The cell is not as it was.
        """
        if self.changed:
            raise CellChanged(f"the cell changed, as {self.page} shows; put right what changed, or calibrate anew")


def check(
    result: CalibratedCell | dict[str, Any] | Path | str,
    plan: LoadedPlan | Path | str,
    *,
    history: Path | str | None = None,
    measured: Path | str | None = None,
    dry_run: bool = False,
    seed: int = 0,
    operator: Operator | None = None,
    settings: CheckSettings | None = None,
) -> InterimCheck:
    """Measure the few poses of a plan that show most of what may have changed, and say whether anything did.

    The cell is compared with its calibration, and with the first check.

    Parameters
    ----------
    result
        The calibrated cell that is checked; a result.json, or the folder that holds one.
    plan
        From which the poses are chosen at the first check; later checks repeat these.
    history
        File of all checks of this cell; default 'check.json' beside the result. It is written whole after each check.
    measured
        Folder of a check that was measured already, and only is to be judged; nothing moves then.
    dry_run, seed
        Against the fake cell, as in ``mbcacq.run``.
    operator
        Who allows a real arm to move, and is asked and informed.
    settings
        How many poses, whether artefacts stand, what usually changes from day to day; it counts at the first check.

    Returns
    -------
    InterimCheck
        The verdict with the history.

    Raises
    ------
    ConfigError
        The plan or the result cannot be used, or the history is of another result or of other poses.
    DeviceFault
        A pose of the check could not be measured: the day does not count.
    SafetyStop, RecordingError
        As ``mbcacq.run``.
    """
    operator, settings, loaded, content = operator or Operator(), settings or CheckSettings(), as_plan(plan), as_result(result)
    cell = CalibratedCell.from_dict(content)
    refuse_uncalibrated(cell, dry_run or measured is not None or on_loopback_only(loaded.plan.robot.options))
    file = _history_file(result, history)
    if not dry_run and measured is None:
        refuse_impossible_devices(loaded)
    with ExitStack() as held:
        file.absolute().parent.mkdir(parents=True, exist_ok=True)
        held.enter_context(write_lock(file.absolute().parent, "check"))
        past = read_history(file)
        operator.progress("checking that every pose can be reached and seen")
        poses = expand(loaded)
        on_part = settings.part or not any(p.balls for p in poses) or (past is not None and past.noise is not None)
        if past is None:
            operator.progress("choosing the poses that notice most")
            past = _new_history(loaded, poses, cell, content, settings)
        elif past.result != digest(content):
            raise ConfigError(f"{file} is the history of another result; give another --history, one for each calibration")
        chosen = _chosen(loaded, poses, past, file)
        judged, counted = with_points(loaded, chosen) if on_part else (loaded, chosen)
        planned = planned_check(judged, counted, cell, past.standing, past.usual_days)
        if measured is None:
            run = _measure(loaded, chosen, operator, settings.folder, past, seed if dry_run else None)
        else:
            run = Path(measured)
        operator.progress("judging")
        measured_now = load_observations(run)
        simulated = measured_now.cell.simulated
        if on_part:
            measured_now, noise = seen_as_points(planned, scenes_as_observations(run, measured_now))
            noise = noise if past.noise is None else past.noise
            past = replace(with_observations(planned, past, measured_now, run), noise=noise)
            planned = with_noise(planned, noise)
        else:
            past = with_observations(planned, past, measured_now, run)
        verdict = verdict_of(planned, past)
        past = past.judged(verdict.log_e, verdict.log_e_calibration)
        past.write(file)
        done = InterimCheck(verdict, past, file, run)
        if is_run_folder(run):
            operator.progress("drawing the page")
            named = result if isinstance(result, Path | str) else file.parent
            about = {"sentence": capitalised(done.sentence), "simulated": simulated, "calibration": str(named)}
            about |= {"version": f"mbcacq {__version__}", "next": done.next_step(named, loaded.path, dry_run)}
            kept = done.to_dict() | shown(planned, past, verdict) | about
            keep_check_result(run, kept)
            write_check_page(kept, done.page)
        operator.progress("")
        return done


def with_observations(planned: PlannedCheck, history: CheckHistory, obs: Observations, run: Path) -> CheckHistory:
    """The history with one more day, recorded in a folder. Raises DeviceFault if a pose of the check is missing in it, ConfigError where
    the day is in the history already."""
    name = str(run.absolute())
    if any(day.run == name for day in history.days):
        raise ConfigError(f"{run} is in the history of these checks already; measure anew")
    fitted = history.standing and bool(history.stations)
    stations = history.stations if fitted else fit_stations(planned, obs)
    residual = residuals_of(planned, obs, stations)
    refuse_incomplete(planned, residual)
    started = str(read_run_identity(run).get("started") or datetime.now(UTC).isoformat(timespec="seconds"))
    today = CheckedDay(time=started, run=name, residual=residual)
    return replace(history, stations=history.stations or stations, days=(*history.days, today))


def _history_file(result: CalibratedCell | dict[str, Any] | Path | str, history: Path | str | None) -> Path:
    if history is not None:
        return Path(history)
    if not isinstance(result, Path | str):
        raise ConfigError("a result that was not read from a file has no folder for its checks; say where their history is to be kept")
    place = Path(result)
    return (place if place.is_dir() else place.parent) / HISTORY


def _new_history(
    loaded: LoadedPlan, poses: list[PlannedPose], cell: CalibratedCell, content: dict[str, Any], settings: CheckSettings
) -> CheckHistory:
    """A history without days, of the poses that notice most. Raises ConfigError if the plan has too few."""
    options, name, days = replace(OPTIONS, poses=settings.poses), loaded.path.name, settings.days
    on_part = settings.part or not any(p.balls for p in poses)
    if on_part:
        chosen = with_points(loaded, poses)[1]
    elif settings.poses < options.fewest:
        raise ConfigError(f"a check of {settings.poses} poses tells hardly any change from another; give {options.fewest} or more")
    else:
        everything = planned_check(loaded, [p for p in poses if p.balls], cell, settings.standing, days)
        numbers = choose_poses(everything, options)
        chosen = [p for p in poses if p.number in numbers]
    standing, numbers, q = settings.standing and not on_part, tuple(p.number for p in chosen), np.array([p.q for p in chosen])
    return CheckHistory(result=digest(content), plan=name, poses=numbers, q=q, standing=standing, usual_days=days)


def _chosen(loaded: LoadedPlan, poses: list[PlannedPose], history: CheckHistory, file: Path) -> list[PlannedPose]:
    """The poses of a history as the plan has them now, in its order. Raises ConfigError if they are others, or cannot be taken."""
    chosen = [p for p in poses if p.number in history.poses]
    q = np.array([p.q for p in chosen])
    if q.shape != history.q.shape or not np.allclose(q, history.q, rtol=0, atol=SAME_ANGLE):
        raise ConfigError(
            f"{loaded.path} no longer has the poses that {file} repeats; take the change of the plan back, or give another --history"
        )
    refuse_errors(loaded, chosen)
    return chosen


def _measure(
    loaded: LoadedPlan, poses: list[PlannedPose], operator: Operator, out: Path | None, past: CheckHistory, fake_seed: int | None
) -> Path:
    """Measure the poses as a run does; its folder. fake_seed: of the fake cell; None: the plan's devices."""
    dry_run, seed = fake_seed is not None, fake_seed or 0
    if dry_run:  # the same cell on another day: what differs from run to run is drawn anew
        options = {"noise_seed": 1_000_003 * (len(past.days) + 1) + seed, **loaded.plan.fake}
        loaded = replace(loaded, plan=loaded.plan.model_copy(update={"fake": options}))
    acquisition = allowed_acquisition(operator, loaded, poses, frozenset(), 0, dry_run, seed)
    acquisition.kind = RunKind.CHECK
    with device_overrides(loaded, poses, dry_run, seed, operator.assume_yes) as overrides:
        folder = acquisition.folder = new_run_folder(out, f"check-{Path(past.plan).stem}")  # one cell, whatever a later plan is called
        with write_lock(folder, "check"):
            operator.began(folder)
            acquisition.execute(overrides, operator.subscribers, message=operator.message, pause=operator.pause)
    return folder
