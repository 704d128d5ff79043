"""From the adjustment of a recording, the solver's result, to the calibrated cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.observation_fit import ObservationFit, Rejected
from mbcacq.estimation import unknown_noise
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.outliers import Weights
from mbcacq.estimation.solution import Solution
from mbcacq.model.observations import Observations

CORRELATED = 0.95


def adjusted_cell(options: CalibrationOptions, adjustment: Adjustment, known_noise: bool = False) -> CalibratedCell:
    """The calibrated cell of an adjustment.

    Parameters
    ----------
    options : CalibrationOptions
        Under which the observations were adjusted.
    adjustment : Adjustment
        Converged.
    known_noise : bool
        Whether the noise is known before the recording, not estimated by it.
    """
    lineariser, solution, weights = adjustment.lineariser, adjustment.solution, adjustment.weights
    obs, layout, normal = lineariser.obs, lineariser.layout, solution.normal
    C = unknown_noise.under_the_noise(solution) if known_noise else unknown_noise.covariance(solution)
    station_covariance = np.zeros((len(obs.cell.stations), 6, 6))
    station_covariance[lineariser.rows.stations] = normal.station_covariance(C)
    rank = layout.size + int(normal.station_rank.sum())
    fit = ObservationFit(
        observations=obs,
        options=options,
        coefficients=solution.estimate.coefficients,
        station_covariance=station_covariance,
        weights=weights,
        residual=solution.linear.residual,
        whitened=solution.whitened_residual,
        chi2=solution.cost,
        dof=int(adjustment.used.sum()) * lineariser.rows.width + solution.prior.rows - rank,
        rank=rank,
        iterations=solution.iterations,
        undetermined=tuple(adjustment.found),
        rejected=_rejected(obs, solution, weights),
        correlated=_correlated(layout.names, C),
    )
    return CalibratedCell.fitted(
        fit=fit, state=solution.estimate.state, preliminary=adjustment.preliminary, layout=layout, covariance=C, noise=adjustment.noise
    )


def _rejected(obs: Observations, solution: Solution, weights: Weights) -> tuple[Rejected, ...]:
    size = np.linalg.norm(solution.linear.residual[:, :3], axis=1)
    out = [
        Rejected(pose=int(obs.pose_id[p]), distance_mm=float(size[obs.pose == p].max(initial=0.0)))
        for p in np.flatnonzero(weights.pose == 0)
    ]
    single = np.flatnonzero((weights.centre == 0) & (weights.pose[obs.pose] > 0))
    return (
        *out,
        *(Rejected(pose=int(obs.pose_id[obs.pose[m]]), ball=obs.cell.ball_ids[obs.ball[m]], distance_mm=float(size[m])) for m in single),
    )


def _correlated(names: Sequence[str], C: np.ndarray) -> tuple[tuple[str, str, float], ...]:
    std = np.sqrt(np.diag(C))
    correlation = C / np.outer(std, std)
    i, j = np.nonzero(np.triu(np.abs(correlation) > CORRELATED, 1))
    order = np.argsort(-np.abs(correlation[i, j]))
    pairs = [(int(i[k]), int(j[k])) for k in order]
    pairs = [(a, b) for a, b in pairs if not names[a].startswith("unknown:") and not names[b].startswith("unknown:")]
    return tuple((names[a], names[b], float(correlation[a, b])) for a, b in pairs)
