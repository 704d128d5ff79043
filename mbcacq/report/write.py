"""Writes the pages of the report: of a result, of a run, of a check, of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.files.atomic_write import write_file
from mbcacq.model.observations import Observations
from mbcacq.report.content import Content, ReportVerdict
from mbcacq.report.page import render, render_check, render_diagnosis
from mbcacq.report.paper import write_pdf
from mbcacq.report.sources.from_diagnosis import diagnosis_content
from mbcacq.report.sources.from_motion import motion_content
from mbcacq.report.sources.from_result import content_of, spacing_of
from mbcacq.report.verdict import beyond_expected_sentence, uncertainty_budget, verdict_of


def report_from_result(
    result: Mapping[str, Any], *, path: str | Path, observations: Observations | None = None, run_info: Mapping[str, Any] | None = None
) -> Path:
    """Write the report of a result.json, with 'verification', 'accuracy_map' and 'gaps' in it or not; a PDF where the name ends in .pdf.

    observations: the recording, for residuals, histogram and coverage. run_info: what ``read_run_info`` returns for a run: optional texts
    'name', 'started', 'folder', 'plan_yaml', mappings 'versions', 'facts', 'diagnosis' and 'pictures', 'with_effects', 'devices', 'hashes'.
    Raises ConfigError for a damaged result or if the libraries for a PDF are missing, RecordingError if the file cannot be written.
    """
    return write_report_page(content_of(result, observations, run_info), path)


def judged(result: Mapping[str, Any]) -> tuple[ReportVerdict, list[tuple[str, str, str]], str]:
    """The verdict on a result, its uncertainty budget, and a sentence on places beyond their expected uncertainty: as page one has them."""
    spacing = spacing_of(result)
    return verdict_of(spacing, result), uncertainty_budget(result.get("verification")), beyond_expected_sentence(spacing)


def write_report_page(content: Content, path: str | Path) -> Path:
    """Write a report as one page. Raises as ``report_from_result``."""
    return _written(partial(render, content), path)


def write_check_page(kept: Mapping[str, Any], path: str | Path) -> Path:
    """Write the page of a check, of what it left in its folder. Raises as ``report_from_result``."""
    return _written(partial(render_check, kept), path)


def _written(draw: Callable[..., str], path: str | Path) -> Path:
    """Write what ``draw`` returns, or, where the name ends in .pdf, what it returns for paper."""
    return write_pdf(partial(draw, paper=True), path) if Path(path).suffix.lower() == ".pdf" else write_file(path, draw())


def write_diagnosis_page(
    poses: Diagnosis | None,
    pictures: Mapping[str, Any] | None,
    path: str | Path,
    title: str = "Diagnosis",
    about: Sequence[tuple[str, str]] = (),
    motion: MotionDiagnosis | PosesAndMotion | None = None,
    checks: Sequence[Transfer] = (),
) -> Path:
    """Write a diagnosis as a page of its own: of poses (with what its pictures need), of motion, or of both.

    motion: with the poses of the same run, where there are both. checks: what was found in poses, tried on other recordings. about: robot,
    data and date (label, text). Raises ConfigError for a motion that was read from JSON, RecordingError if the file cannot be written.
    """
    of_poses = None if poses is None else diagnosis_content(poses, pictures, checks)
    return write_file(path, render_diagnosis(of_poses, None if motion is None else motion_content(motion), title, about))
