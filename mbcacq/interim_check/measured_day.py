"""From the recording of a check to its residuals against the calibrated cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbcacq.errors import DeviceFault
from mbcacq.estimation import forward_model
from mbcacq.geometry import se3
from mbcacq.interim_check.options import OPTIONS
from mbcacq.interim_check.planned_check import PlannedCheck
from mbcacq.interim_check.possible_changes import jitter, rows_of, station_columns
from mbcacq.model.observations import Observations

Residuals = Mapping[tuple[int, int], np.ndarray]
FEWEST_BALLS = 3  # of a pose: two leave a turn about their line open


def residuals_of(check: PlannedCheck, obs: Observations, stations: Mapping[str, np.ndarray]) -> dict[tuple[int, int], np.ndarray]:
    """(pose number, ball id) -> (3,) mm, measured minus predicted by the calibrated cell with its effects and these stations."""
    state = replace(check.state, T_base_station=_stations(check, obs, stations))
    displaced = None if not check.cell.effects else check.cell.effects.displacements(obs)
    r = obs.xyz - forward_model.predict(obs, state, displaced).xyz
    expected = set(check.keys)
    keys = [(int(obs.pose_id[p]), obs.cell.ball_ids[b]) for p, b in zip(obs.pose, obs.ball, strict=True)]
    return {key: r[m] for m, key in enumerate(keys) if key in expected}


def fit_stations(check: PlannedCheck, obs: Observations) -> dict[str, np.ndarray]:
    """T_base_station (4, 4) by id, as a check finds the artefacts with the calibrated arm: weighted least squares from where the plan means
    them to stand."""
    at = dict(_planned(check))
    displaced = None if not check.cell.effects else check.cell.effects.displacements(obs)
    for _ in range(OPTIONS.station_rounds):
        state = replace(check.state, T_base_station=_stations(check, obs, at))
        prediction = forward_model.predict(obs, state, displaced)
        root = np.linalg.cholesky(jitter(obs, state, prediction, check.cell.noise.point, check.cell.noise.joint))
        white = np.linalg.solve(root, (obs.xyz - prediction.xyz).reshape(-1))
        for s, columns in station_columns(obs, prediction).items():
            step = np.linalg.lstsq(np.linalg.solve(root, rows_of(columns)), white, rcond=None)[0]
            name = obs.cell.stations[s].id
            at[name] = at[name] @ se3.exp(step)
    return at


def _planned(check: PlannedCheck) -> dict[str, np.ndarray]:
    return {s.id: T for s, T in zip(check.obs.cell.stations, check.state.T_base_station, strict=True)}


def _stations(check: PlannedCheck, obs: Observations, given: Mapping[str, np.ndarray]) -> np.ndarray:
    """(S, 4, 4) in the order of a recording's stations."""
    planned = _planned(check)
    return np.stack([given.get(s.id, planned.get(s.id, np.eye(4))) for s in obs.cell.stations])


def refuse_incomplete(check: PlannedCheck, residual: Residuals) -> None:
    """Raises DeviceFault if a pose of the check was not measured, or shows fewer than three of its balls: a day counts whole."""
    for pose in check.poses:
        found = sum(number == pose.number for number, _ in residual)
        if found < min(FEWEST_BALLS, len(pose.balls)):
            raise DeviceFault(
                f"pose {pose.number} of the check (step '{pose.step_name}', station '{pose.station}') was not measured, so that this day "
                "does not count; clear its view and check again"
            )
