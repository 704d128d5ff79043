"""From the recording of a run to a calibrated and verified cell, with its files in the folder of the run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbcacq.calibration import Calibration, CalibrationOptions, Verification, calibrate, verify
from mbcacq.calibration.accuracy_map import accuracy_map
from mbcacq.errors import CalibrationError
from mbcacq.model.observations import Observations
from mbcacq.workflow.load import load_observations


@dataclass(frozen=True, repr=False)
class RunResult:
    """What a run gave. content: that of result.json, with 'verification', 'accuracy_map', 'gaps' and 'files' (recording, result, report).
    limit_mm: the plan's limit of the sphere spacing error, or None."""

    folder: Path
    calibration: Calibration
    verification: Verification
    content: dict[str, Any]
    limit_mm: float | None = None

    @property
    def worst_mm(self) -> float | None:
        """Largest sphere spacing error after calibration; None where nothing was verified."""
        return (self.content.get("verification") or {}).get("after", {}).get("max_mm")

    def refuse_beyond_limit(self) -> None:
        """Raises CalibrationError where the largest sphere spacing error is above the plan's limit."""
        worst = self.worst_mm
        if self.limit_mm is not None and worst is not None and worst > self.limit_mm:
            raise CalibrationError(
                f"the largest sphere spacing error is {worst:.3f} mm, above the plan's limit of {self.limit_mm:g} mm; "
                f"see {self.content['files']['report']}"
            )

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json with the names of the files."""
        return self.content

    def __repr__(self) -> str:
        return f"RunResult({str(self.folder)!r}, {self.calibration!r}, {self.verification!r})"

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_() + self.verification._repr_html_()


def evaluate(run: Path, limit_mm: float | None = None) -> RunResult:
    """Calibrate what a run recorded, verify it on the poses kept apart, write result.json, report.html and the residuals into its folder.

    A plan without phase 'position' (the artefact at several places) cannot determine the whole cell and is not refused for that: what
    its poses leave open is held, and the standard deviations show it. limit_mm: the plan's limit of the sphere spacing error.
    """
    from mbcacq.recording import find_gaps, log_result
    from mbcacq.recording.datasets.csvfile import write_text
    from mbcacq.recording.run_folder.recovery import WHOLE
    from mbcacq.report import read_run_info, report_from_result

    observations = load_observations(run)
    calibration = calibrate(observations, CalibrationOptions(refuse=determines_all(observations)))
    verification = verify(observations, calibration, limit_mm=limit_mm)
    content = calibration.to_dict() | {
        "verification": verification.to_dict(),
        "accuracy_map": accuracy_map(calibration).to_dict(),
        "gaps": find_gaps(run),
    }
    write_text(run / "result.json", json.dumps(content, indent=1))
    report = report_from_result(content, path=run / "report.html", observations=observations, run_info=read_run_info(run))
    log_result(run, observations, calibration.state, calibration.preliminary)
    recording = run / WHOLE if (run / WHOLE).exists() else run / "run.rrd"
    content = content | {"files": {"recording": str(recording), "result": str(run / "result.json"), "report": str(report)}}
    return RunResult(run, calibration, verification, content, limit_mm)


def determines_all(observations: Observations) -> bool:
    """Whether these poses are meant to determine the whole cell: of a plan, those with phase 'position'; any without phases."""
    return observations.phase is None or "position" in observations.phase
