"""The report: one self-contained HTML page that says how good a calibrated cell is, and why."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbcacq.report.run_folder import about_run

if TYPE_CHECKING:
    from mbcacq.calibration import Calibration, Verification
    from mbcacq.observations import Observations

__all__ = ["about_run", "report_from_result", "write_report"]


def report_from_result(result: Mapping[str, Any], *, path: str | Path, observations: Observations | None = None,
                       run_info: Mapping[str, Any] | None = None) -> Path:
    """Write the report of a result.json, with 'verification' in it or not.

    observations: the recording, for residuals, histogram and coverage. run_info: optional texts 'name', 'started', 'plan_yaml', and
    mappings 'versions' and 'facts'. Raises ConfigError for a damaged result, RecordingError where the file cannot be written.
    """
    from mbcacq.report.from_result import content_of
    from mbcacq.report.page import write

    return write(content_of(result, observations, run_info), path)


def write_report(run_folder: str | Path, *, observations: Observations, calibration: Calibration, verification: Verification | None = None,
                 run_info: Mapping[str, Any] | None = None, path: str | Path | None = None) -> Path:
    """Write the report of a calibration to ``path``, or report.html in the run folder."""
    result = calibration.to_dict()
    if verification is not None:
        result["verification"] = verification.to_dict()
    info = about_run(run_folder) if run_info is None else run_info
    return report_from_result(result, path=path or Path(run_folder) / "report.html", observations=observations, run_info=info)
