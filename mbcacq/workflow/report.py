"""The report of a run, a recording or a calibration: one HTML page."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.sufficiency import options_for
from mbcacq.calibration.workspace_accuracy import accuracy_map
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.exports.result_json import load_result
from mbcacq.model.observations import Observations
from mbcacq.recording.rrd.reader import opened_once
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.latest import refuse_plan
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.register import RunKind, kind_of
from mbcacq.report.sources.check_result import read_check_result
from mbcacq.report.sources.from_result import content_of
from mbcacq.report.sources.run_folder import read_run_info
from mbcacq.report.write import write_check_page, write_report_page
from mbcacq.workflow.diagnose_recordings import Question, combined_with_motion, diagnose_poses
from mbcacq.workflow.load import as_observations, is_run_folder, unsealed_note


def write_report(
    data: CalibratedCell | Path | str,
    out: Path | str | None = None,
    *,
    diagnose: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write a report: one HTML page that opens offline and prints well, or a PDF.

    Parameters
    ----------
    data
        A calibration, or a run folder, a recording (.rrd), an observation set. A result.json and a diagnosis that are kept in a run folder
        are used; otherwise the cell is calibrated.
    out
        The page (default: report.html in the folder), or a PDF if the name ends in .pdf.
    diagnose
        Make a diagnosis if there is none.
    progress
        Called with a sentence for each step.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError, CalibrationError
        The data cannot be used.
    RecordingError
        The file cannot be written, or another process writes in the run folder.
    """
    return report_and_next(data, out, diagnose, progress)[0]


def report_and_next(
    data: CalibratedCell | Path | str, out: Path | str | None, diagnose: bool, progress: Callable[[str], None]
) -> tuple[Path, tuple[str, str]]:
    """As ``write_report``, with what its page proposes next, in words, and the command for that."""
    run = None if isinstance(data, CalibratedCell) else Path(data)
    if out is None and run is None:
        raise ConfigError("a calibration has no folder; say where the report is to go")
    if out is None and run is not None and run.is_file():
        refuse_plan(run)
        raise ConfigError(f"{run} is a file, no folder; say where the report is to go with --out")
    if run is not None and run.is_dir() and kind_of(run) is RunKind.CHECK and not (run / "result.json").exists():
        with write_lock(run, "report"):
            kept = read_check_result(run)
            return write_check_page(kept, run / "report.html" if out is None else out), tuple(kept["next"])
    with write_lock(run, "report") if run is not None and is_run_folder(run) else nullcontext(), opened_once():
        return _write(data, run, out, diagnose, progress)


def _write(
    data: CalibratedCell | Path | str, run: Path | None, out: Path | str | None, diagnose: bool, progress: Callable[[str], None]
) -> tuple[Path, tuple[str, str]]:
    """The report; whoever calls holds the lock of the run folder."""
    progress("reading the recording")
    observations = data.fit.observations if isinstance(data, CalibratedCell) else as_observations(data)
    result = _result(data, observations, progress)
    if run is not None and run.is_dir():
        result["gaps"] = [*find_gaps(run), *(unsealed_note(run) if (run / "result.json").exists() else ())]
    if observations.cell.simulated:
        result["simulated"] = True
    progress("reading timing and health of the devices")
    info = {} if run is None else {"folder": str(run), "name": run.name} | (read_run_info(run) if run.is_dir() else {})
    if diagnose and "diagnosis" not in info:
        info |= _diagnosis(observations, run, progress)
    progress("drawing the report")
    target = Path(out) if out is not None else Path(run or "") / "report.html"
    page = content_of(result, observations, info)
    return write_report_page(page, target), page.next_step()


def _result(data: CalibratedCell | Path | str, observations: Observations, progress: Callable[[str], None]) -> dict[str, Any]:
    """The content of result.json with 'accuracy_map': the one that is kept in a run folder, or computed."""
    kept = None
    if not isinstance(data, CalibratedCell) and Path(data).is_dir() and (Path(data) / "result.json").exists():
        kept = load_result(Path(data))
        if "accuracy_map" in kept:
            return kept
    if isinstance(data, CalibratedCell):
        calibration = data
    else:
        progress("calibrating")
        calibration = calibrate(observations, options_for(observations, CalibrationOptions()))
    if kept is None:
        kept = calibration.to_dict() | {"verification": calibration.verify(observations).to_dict()}
    return kept | {"accuracy_map": accuracy_map(calibration, calibration.fit.observations).to_dict()}


def _diagnosis(observations: Observations, run: Path | None, progress: Callable[[str], None]) -> dict[str, Any]:
    """A new diagnosis for the report, kept in the folder of the run where there is one."""
    how = Question(progress=progress, workers=1)
    found = diagnose_poses(observations, how)
    found = found if run is None else combined_with_motion(found, run, how)
    if run is not None and is_run_folder(run):
        found.keep(run)
    return {"diagnosis": found.to_dict(), "pictures": found.pictures()}
