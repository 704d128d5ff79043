"""From the recording of a run to a calibrated and verified cell, with its files in the folder of the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import beyond_limit
from mbcacq.calibration.sufficiency import HAND_EYE_ALONE, options_for
from mbcacq.calibration.verification import Verification
from mbcacq.calibration.workspace_accuracy import accuracy_map
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.files.atomic_write import write_file
from mbcacq.model.json_text import sealed_text
from mbcacq.model.observations import Observations
from mbcacq.recording.rrd.reader import opened_once
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.recovery import WHOLE
from mbcacq.report.cards import verdict_card
from mbcacq.report.content import Content
from mbcacq.report.sources.from_result import content_of
from mbcacq.report.sources.run_folder import read_run_info
from mbcacq.report.write import write_report_page
from mbcacq.workflow.corrected_targets import improvement_of_run
from mbcacq.workflow.load import as_observations, counted_joints


@dataclass(frozen=True, repr=False, kw_only=True)
class RunResult:
    """What a run gave.

    Attributes
    ----------
    folder
        The folder of the run.
    calibration
        The calibrated cell.
    verification
        Sphere spacing errors at the verification poses.
    content
        The content of result.json, with 'verification', 'accuracy_map', 'gaps' and 'files' (recording, result, report).
    limit_mm
        The plan's limit of the sphere spacing error, mm, or None.
    next_step
        What to do next in words, and the command for it or ''.
    """

    folder: Path
    calibration: CalibratedCell
    verification: Verification
    content: dict[str, Any]
    limit_mm: float | None = None
    next_step: tuple[str, str] = ("", "")

    @property
    def worst_mm(self) -> float | None:
        """Largest sphere spacing error after calibration; None where nothing was verified."""
        return (self.content.get("verification") or {}).get("after", {}).get("max_mm")

    def refuse_beyond_limit(self) -> None:
        """Raise an error if the calibration is not good enough.

        Raises
        ------
        CalibrationError
            A sphere spacing error is beyond the plan's limit by more than the uncertainty of judging it.
        """
        if sentence := beyond_limit(self.content):
            raise CalibrationError(f"{sentence}; see {self.content['files']['report']}")

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json with the names of the files.

        Returns
        -------
        dict
            As ``content``.
        """
        return self.content

    def __repr__(self) -> str:
        return f"RunResult({str(self.folder)!r}, {self.calibration!r}, {self.verification!r})"

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_() + self.verification._repr_html_()


def evaluate(run: Path, limit_mm: float | None = None, progress: Callable[[str], None] = lambda text: None) -> RunResult:
    """Calibrate what a run recorded, verify it on the poses kept apart, write result.json, report.html and the residuals into its folder.

    The plan's phases and stations decide the parameters that are calibrated (``options_for``). limit_mm: the plan's limit of the sphere
    spacing error. progress: gets a sentence a step.
    """
    with opened_once():
        return _evaluated(run, limit_mm, progress)


def _evaluated(run: Path, limit_mm: float | None, progress: Callable[[str], None]) -> RunResult:
    progress("reading the recording")
    observations = as_observations(run)
    progress("calibrating and verifying")
    options, improved = options_for(observations, CalibrationOptions()), improvement_of_run(run, observations)
    if improved is not None:  # it shows what a calibration changed, and need not determine the arm once more
        options = replace(options, refuse=False)
    calibration = calibrate(observations, options)
    verification = calibration.verify(observations, limit_mm=limit_mm)
    content = calibration.to_dict() | {
        "verification": verification.to_dict(),
        "accuracy_map": accuracy_map(calibration, calibration.fit.observations).to_dict(),
        "gaps": find_gaps(run),
        **counted_joints(run, observations.cell.robot.n),
    }
    if not options.kinematics:
        content["scope"] = HAND_EYE_ALONE
    if improved is not None:
        content["arm_improved"] = improved.to_dict()
    write_file(run / "result.json", sealed_text(content))
    progress("writing the report")
    page = content_of(content, observations, read_run_info(run))
    report = write_report_page(page, run / "report.html")
    show_in_viewer(run, observations, calibration, page, compared=options.kinematics)
    recording = run / WHOLE if (run / WHOLE).exists() else run / "run.rrd"
    content = content | {"files": {"recording": str(recording), "result": str(run / "result.json"), "report": str(report)}}
    return RunResult(
        folder=run, calibration=calibration, verification=verification, content=content, limit_mm=limit_mm, next_step=page.next_step()
    )


def show_in_viewer(run: Path, observations: Observations, calibration: CalibratedCell, page: Content, *, compared: bool = True) -> Path:
    """Write the calibrated cell, with its effects, as result.rrd of the run, beside the recording.

    page: the report, whose verdict is shown. compared: with the cell before (a fit of the hand-eye transform alone is no state before
    itself). Raises RecordingError.
    """
    from mbcacq.recording.rrd.result_recording import Judgement, log_result

    judgement = Judgement(text=verdict_card(page))
    if (s := page.spacing) is not None:
        judgement = Judgement(text=judgement.text, place=s.place, before=s.before, error=s.after, sigma=s.sigma, limit=s.limit)
    return log_result(run, observations, calibration.state, calibration.preliminary if compared else None, judgement, calibration.effects)
