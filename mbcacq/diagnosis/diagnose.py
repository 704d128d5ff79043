"""``diagnose``: observations in, verdict out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis import outlier_readmission
from mbcacq.diagnosis.linearized.variance_components import MANY_POSES
from mbcacq.diagnosis.model_fit import ModelFit, find
from mbcacq.diagnosis.problem import prepare, thin
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.validation import cross_validation
from mbcacq.diagnosis.verdict import WEAK, conclude
from mbcacq.errors import CalibrationError
from mbcacq.model.observations import Observations

MOST_POSES = 4000
FEWEST_POSES = 12
FEW_STATIONS = 6  # up to which each is left out alone


def diagnose(obs: Observations, folds: int | None = None, progress=lambda text: None, workers: int = 1) -> Diagnosis:
    """Locate, explain, prove. workers: processes side by side for the proof, of a recording that is not long.

    Raises CalibrationError where the data do not even determine the geometry.
    """
    if obs.n_poses < FEWEST_POSES:
        raise CalibrationError(f"{obs.n_poses} poses are too few for a diagnosis: measure at least {FEWEST_POSES}")
    try:
        return _diagnose(obs, folds, progress, workers)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recording does not determine the cell ({error}): measure more stations and orientations") from error


def _diagnose(obs: Observations, folds: int | None, progress, workers: int) -> Diagnosis:
    progress("fitting the geometry")
    setup = outlier_readmission.readmitted(prepare(obs))
    extra = []
    if obs.n_poses > MOST_POSES:
        setup = thin(setup, setup.linear.keep, MOST_POSES)
        extra = [f"of {obs.n_poses} poses {MOST_POSES}, evenly at random, were used"]
    progress("searching for effects")
    full = find(setup)
    progress("proving on data left out")
    if obs.n_poses >= MANY_POSES:
        workers = 1  # each would need as much memory as all of them in turn
    proof = cross_validation.prove(setup, full, folds or usual_folds(obs, full), workers)
    result = conclude(setup, full, proof)
    return replace(result, notes=(*result.notes, *extra))


def usual_folds(obs: Observations, full: ModelFit) -> int:
    if obs.n_poses >= MANY_POSES:
        return 3 if obs.n_poses < 2000 else 2
    if full.smooth is None and 0 < full.model.score < WEAK:
        return 8
    stations = len(np.unique(obs.station))
    return stations if 4 < stations <= FEW_STATIONS else 4
