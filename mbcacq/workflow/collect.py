"""From clouds in a folder to a calibrated cell: the acquisition of an arm or a scanner that is not driven from here."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from mbcacq.acquisition.collected.collected_run import CollectedPose, CollectedRun
from mbcacq.errors import ConfigError
from mbcacq.plan import LoadedPlan, expand
from mbcacq.recording.datasets.cell_yaml import cell_to_yaml
from mbcacq.recording.run_folder.latest import mark_latest
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.register import RunKind
from mbcacq.recording.run_folder.run_plan import plan_files_text
from mbcacq.spheres.cloud_files import says_simulated
from mbcacq.workflow import resume as resuming
from mbcacq.workflow.acquire import new_run_folder, recorded, solver_cell, versions
from mbcacq.workflow.cloud_session import CloudSession, Sources, paired, read_session
from mbcacq.workflow.evaluate import RunResult, evaluate
from mbcacq.workflow.load import as_plan
from mbcacq.workflow.run import Operator

CELL = "clouds collected from files"


@dataclass(frozen=True)
class PairedClouds:
    """The clouds of each pose that has some, and sentences on what was odd: (number of the pose that is left out by it or None, text)."""

    poses: tuple[CollectedPose, ...]
    notes: tuple[tuple[int | None, str], ...]
    session: CloudSession = field(repr=False)


def pair_clouds(
    plan: LoadedPlan | Path | str, sources: Sources | Path | str, *, done: frozenset[int] = frozenset(), operator: Operator | None = None
) -> PairedClouds:
    """Pair the clouds of a folder with the poses of a plan that are not ``done``, and say what is odd; nothing is recorded.

    Raises ConfigError as ``collect`` does.
    """
    operator, loaded = operator or Operator(), as_plan(plan)
    sources = sources if isinstance(sources, Sources) else Sources(Path(sources))
    operator.progress("looking for postures that reach every pose")
    session = read_session(loaded, expand(loaded), sources, done, operator.progress)
    collected = paired(session, sources, done)
    operator.progress("")
    return PairedClouds(tuple(collected), tuple(session.notes), session)


def collect(
    plan: LoadedPlan | Path | str,
    sources: Sources | Path | str,
    *,
    out: Path | str | None = None,
    resume: Path | str | None = None,
    operator: Operator | None = None,
) -> RunResult:
    """Make a run from the clouds of a folder: pair them with the poses of a plan, find their balls, judge them, calibrate.

    The clouds are paired by their order and by what they show. Clouds that are missing, doubled, half written, exchanged or of something
    else are named. The folder of the run holds recording, result and report.

    Parameters
    ----------
    plan
        The plan whose poses the arm went through.
    sources
        The clouds; a path is the folder of the clouds.
    out
        Folder of the run (default runs/TIME_NAME).
    resume
        Add to this run what it lacks.
    operator
        Who is informed.

    Returns
    -------
    RunResult
        The calibrated and verified cell with its files.

    Raises
    ------
    ConfigError
        The clouds as a whole are in another unit, have other axes, or are of another plan or mount.
    CalibrationError, RecordingError
        As ``mbcacq.run``.
    """
    if resume is not None and out is not None:
        raise ConfigError("--resume and --out exclude each other: what is added goes into the run's own folder")
    operator, loaded = operator or Operator(), as_plan(plan)
    sources = sources if isinstance(sources, Sources) else Sources(Path(sources))
    folder = None if resume is None else Path(resume)
    with ExitStack() as held:
        if folder is not None and folder.is_dir():
            held.enter_context(write_lock(folder, "collect --resume"))
        before = resuming.progress_before(folder, loaded, CELL, operator.message)
        if sources.joints is None:
            operator.message("joint angles are those of the plan; the arm's own log is given with --joints")
        found = pair_clouds(loaded, sources, done=before.done, operator=operator)
        evaluated = folder is None or all((folder / name).exists() for name in ("result.json", "report.html"))
        if not found.poses and (evaluated or not before.done):
            for _, text in found.notes:
                operator.message(text)
            raise ConfigError(f"{sources.clouds}: no cloud belongs to a pose that is still missing; look at the messages above")
        if folder is None:
            folder = new_run_folder(None if out is None else Path(out), loaded.path.stem)
            held.enter_context(write_lock(folder, "collect"))
        if found.poses:  # none: what was interrupted is the calibration
            _record(found, folder, before.part, before.done, operator)
        return evaluate(folder, loaded.plan.accept.sphere_spacing_error_mm, operator.progress)


def _record(found: PairedClouds, folder: Path, part: int, done: frozenset[int], operator: Operator) -> None:
    session, collected = found.session, found.poses
    loaded = session.loaded
    simulated = any(says_simulated(path) for here in collected for path in here.clouds[:1])
    plan_files = plan_files_text(loaded.files, CELL, RunKind.COLLECTED, loaded.path)
    known = resuming.measured_balls(folder, loaded, done) if done else {}
    with recorded(folder, loaded, plan_files, operator.subscribers, part=part, message=operator.message) as bus:
        mark_latest(folder)
        CollectedRun(
            loaded=loaded,
            n_poses=len(session.poses),
            poses=collected,
            notes=session.notes,
            bus=bus,
            read=session.read,
            find_balls=session.find,
            cell_yaml=cell_to_yaml(replace(solver_cell(loaded), simulated=simulated)),
            versions=versions(),
            simulated=simulated,
            plan_files=plan_files,
            known=known,
        ).run()
