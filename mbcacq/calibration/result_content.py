"""What result.json says of a calibrated cell and of the observations that it was calibrated from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.observability import arm_indices
from mbcacq.calibration.observation_fit import ObservationFit, parameters_of
from mbcacq.calibration.result_file import (
    FORMAT,
    BallInResult,
    Correlated,
    FitInResult,
    NoiseInResult,
    Preliminary,
    ResultFile,
    RobotInResult,
    StationInResult,
)
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.noise import first_noise
from mbcacq.estimation.scan_scale import scale_in_words, scan_scale


def result_file(
    estimate: CellEstimate, fit: ObservationFit, *, preliminary: CellState, simulated: bool, expected_accuracy_mm: float
) -> ResultFile:
    """The content of a result.

    Parameters
    ----------
    estimate
        The calibrated cell.
    fit
        The observations with residuals and weights.
    preliminary
        Nominal arm, hand-eye fitted alone.
    simulated
        Whether a fake cell or a model made the data.
    expected_accuracy_mm
        The rms uncertainty of a measured point, mm.

    Returns
    -------
    ResultFile
        Stations are those that took part.
    """
    cell, state = fit.observations.cell, estimate.state
    noise = NoiseInResult.of(estimate.noise, oriented=fit.oriented)
    if cell.noise_mm is not None:
        noise = replace(noise, check_factor=tuple((estimate.noise.point / first_noise(cell).point).tolist()))
    used = set(fit.used_stations)
    stations = [
        StationInResult(id=station.id, artefact=station.artefact, T_base_station=state.T_base_station[s], std=np.sqrt(np.diag(covariance)))
        for s, (station, covariance) in enumerate(zip(cell.stations, fit.station_covariance, strict=True))
        if s in used
    ]
    return ResultFile(
        format=FORMAT,
        method=fit.options.method,
        measurement=cell.measurement,
        simulated=simulated,
        robot=RobotInResult.of(cell.robot, state.chain),
        T_flange_scanner=state.T_flange_scanner,
        stations=tuple(stations),
        balls=tuple(BallInResult(b, state.balls[i]) for i, b in enumerate(cell.ball_ids)),
        preliminary=Preliminary(preliminary.T_flange_scanner),
        parameters=tuple(parameters_of(fit, estimate.layout, state, estimate.covariance)),
        names=estimate.names,
        covariance=estimate.covariance,
        noise=noise,
        fit=FitInResult(
            poses=fit.used_poses,
            centres=int(fit.used.sum()),
            rms_mm=fit.rms_mm,
            chi2=fit.chi2,
            dof=fit.dof,
            chi2_dof=fit.chi2 / fit.dof if fit.dof > 0 else None,
            rank=fit.rank,
            iterations=fit.iterations,
            expected_accuracy_mm=expected_accuracy_mm,
        ),
        observability=arm_indices(estimate.layout, estimate.covariance, fit.used_poses),
        scan_scale=scan_scale(fit.observations, fit.used, estimate.noise.point),
        scale=scale_in_words(fit.observations),
        held=estimate.layout.held,
        correlated=tuple(Correlated((a, b), r) for a, b, r in fit.correlated),
        rejected=fit.rejected,
        effects=estimate.effects.to_dict() if estimate.effects else None,
    )
