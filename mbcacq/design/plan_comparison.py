"""Plans compared: the accuracy predicted for each, and what simulated cells show that are recorded by it and calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.calibration.verification import verification_poses
from mbcacq.design.options import OPTIONS
from mbcacq.design.predicted_accuracy import PredictedAccuracy, predicted_accuracy
from mbcacq.design.simulated_observations import planned_noise, planned_observations, simulated_recording
from mbcacq.errors import CalibrationError
from mbcacq.plan import LoadedPlan, PlannedPose

NO_INDICES: dict[str, float | None] = dict.fromkeys(("O1", "O2", "O3", "O4", "O5"))


@dataclass(frozen=True)
class Simulated:
    """Errors (mm) of the certified distances over random true cells: mean of |error| with its standard error, and the largest."""

    mean_mm: float
    standard_error_mm: float
    max_mm: float
    cells: int


def simulated_error(loaded: LoadedPlan, poses: Sequence[PlannedPose], seed: int = 1) -> Simulated | None:
    """Errors of random cells that are each recorded with noise, calibrated, and verified.

    None if the plan has no verification poses, or does not suffice to calibrate.
    """
    cells = OPTIONS.simulated_cells
    rng, observations, noise = np.random.default_rng(seed), planned_observations(loaded, poses), planned_noise(loaded, poses)
    if verification_poses(observations).n_poses == 0:
        return None
    errors = []
    for _ in range(cells):
        recorded = simulated_recording(loaded, observations, noise, rng)
        try:
            found = calibrate(recorded)
        except CalibrationError:
            return None
        errors.append(np.abs(verify(recorded, found).errors("after")))
    means = np.array([e.mean() for e in errors])
    return Simulated(float(means.mean()), float(means.std(ddof=1) / np.sqrt(cells)), float(np.max(errors)), cells)


def compare(plans: Sequence[tuple[LoadedPlan, Sequence[PlannedPose]]], seed: int = 0) -> list[dict[str, Any]]:
    """Expected and simulated accuracy of each plan, in flat dictionaries."""
    out = []
    for loaded, poses in plans:
        try:
            predicted: PredictedAccuracy | None = predicted_accuracy(loaded, poses)
        except CalibrationError:
            predicted = None
        found = predicted and simulated_error(loaded, poses, seed=seed)
        indices: Mapping[str, float | None] = NO_INDICES if predicted is None else predicted.indices
        out.append(
            {
                "poses": sum(p.phase != "verification" for p in poses),
                "expected_bar_mean_mm": predicted and predicted.distance_mm,
                "expected_bar_mean_of_calibration_mm": predicted and predicted.calibration_mm,
                "expected_workspace_mm": predicted and predicted.workspace_mm,
                **indices,
                "simulated_bar_mean_mm": found and found.mean_mm,
                "simulated_standard_error_mm": found and found.standard_error_mm,
                "simulated_bar_max_mm": found and found.max_mm,
            }
        )
    return out
