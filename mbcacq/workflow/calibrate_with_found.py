"""Calibrate a recording with the effects that its diagnosis found, and compare the bar before and after calibration, and after effects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.verification import Verification
from mbcacq.calibration.workspace_accuracy import accuracy_map
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.files.atomic_write import write_files
from mbcacq.model.json_text import sealed_text
from mbcacq.model.observations import Observations
from mbcacq.quantities import fixed
from mbcacq.report.charts.spacing_svg import stages_picture
from mbcacq.report.sources.from_result import content_of
from mbcacq.report.sources.run_folder import read_kept_findings
from mbcacq.workflow.calibrate import calibrate
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.evaluate import show_in_viewer
from mbcacq.workflow.load import counted_joints


@dataclass(frozen=True)
class CalibratedWithFound:
    """geometry, with_effects: the two calibrations; by_geometry, by_effects: their verifications on the same poses.

    with_effects is None if nothing was found that a calibration could take.
    """

    geometry: CalibratedCell
    by_geometry: Verification
    with_effects: CalibratedCell | None = None
    by_effects: Verification | None = None

    @property
    def stages(self) -> dict[str, np.ndarray]:
        """Name of the stage -> (places,) signed sphere spacing errors in mm; without verification poses they are empty."""
        out = {"before": self.by_geometry.errors("before"), "after calibration": self.by_geometry.errors("after")}
        return out if self.by_effects is None else out | {"after effects": self.by_effects.errors("after")}

    @property
    def places(self) -> list[str]:
        """Station of each sphere spacing."""
        return [str(place.station) for place in self.by_geometry.places]

    @property
    def text(self) -> str:
        """A sentence with the errors of the stages."""
        if not self.places:
            return "There are no verification poses: no certified length says how good the calibration is."
        figures = ", ".join(
            f"{name} {fixed(np.abs(errors).mean())} mm (largest {fixed(np.abs(errors).max())} mm)" for name, errors in self.stages.items()
        )
        nothing = "" if self.with_effects else " No effect was found that a calibration could take."
        return f"Sphere spacing error at {len(self.places)} places, mean: {figures}.{nothing}"

    def result(self) -> dict[str, Any]:
        """The content of result.json of the better described cell."""
        calibration, verified = self.with_effects or self.geometry, self.by_effects or self.by_geometry
        return calibration.to_dict() | {
            "verification": verified.to_dict(),
            "accuracy_map": accuracy_map(calibration, calibration.fit.observations).to_dict(),
        }

    def write(self, folder: Path) -> list[Path]:
        """Write result.json and, where there are verification poses, bar.svg; the files. Raises RecordingError if that is impossible, also
        where the folder is a link that leads out of the one above it."""
        files = {"result.json": sealed_text(self.result() | counted_joints(folder.parent, self.geometry.nominal.n))}
        if self.places:
            files["bar.svg"] = stages_picture(self.places, self.stages, self.result()["verification"].get("expected_mean_mm"))
        return write_files(folder.parent, {f"{folder.name}/{name}": content for name, content in files.items()})

    def show_in_viewer(self, run: Path, observations: Observations) -> Path:
        """Show the better described cell and the verdict on it beside the recording of a run, whose folder holds what ``write`` wrote; the
        file. Raises RecordingError if that is impossible."""
        geometry = self.geometry.to_dict() | {"verification": self.by_geometry.to_dict()}
        better = read_kept_findings(run).get("with_effects")
        page = content_of(geometry, None, {"folder": str(run), "with_effects": better})  # of which the viewer shows the verdict alone
        return show_in_viewer(run, observations, self.with_effects or self.geometry, page)


def calibrate_with_found(
    found: DiagnosisResult, options: CalibrationOptions | None = None, limit_mm: float | None = None
) -> CalibratedWithFound:
    """Both calibrations of the recording that was diagnosed, verified. limit_mm: largest sphere spacing error permitted. Raises ConfigError
    for a diagnosis without poses, CalibrationError if they do not determine the cell.
    """
    obs = found.observations
    if obs is None:
        raise ConfigError("--calibrate needs one recording of poses at standstill; give it alone")
    geometry = calibrate(obs, options)
    by_geometry = geometry.verify(obs, limit_mm=limit_mm)
    if not found.model:
        return CalibratedWithFound(geometry, by_geometry)
    better = calibrate(obs, options, effects=found.model)
    return CalibratedWithFound(geometry, by_geometry, better, better.verify(obs, limit_mm=limit_mm))
