"""Initial guess and Gauss-Newton fit of the free geometry alone, on whitened rows, with gross outliers rejected."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.errors import CalibrationError
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations


def initial_state(obs: Observations) -> CellState:
    """Nominal arm and given hand-eye; each station's pose is that of its points brought into the base frame."""
    cell = obs.cell
    T_base_scanner = cell.robot.chain.frames(obs.q)[:, -1] @ cell.T_flange_scanner
    T = np.tile(np.eye(4), (len(cell.stations), 1, 1))
    for s, station in enumerate(cell.stations):
        rows = obs.station[obs.pose] == s
        if station.T_base_station is not None:
            T[s] = station.T_base_station
        elif rows.any() and cell.measurement == TARGET_IN_BASE:
            T[s] = rigid_alignment(obs.xyz[rows], se3.apply(T_base_scanner[obs.pose[rows]], cell.ball_centres[obs.ball[rows]]))
        elif rows.any():
            T[s] = rigid_alignment(cell.ball_centres[obs.ball[rows]], se3.apply(T_base_scanner[obs.pose[rows]], obs.xyz[rows]))
    return CellState(cell.robot.chain, cell.T_flange_scanner, T, cell.ball_centres.copy())


def rigid_alignment(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rigid transform (4, 4) that brings points a (N, 3) onto b: least squares about their medians (Kabsch 1976)."""
    ca, cb = np.median(a, axis=0), np.median(b, axis=0)
    R = se3.nearest_rotation((b - cb).T @ (a - ca)) if len(a) > 1 else np.eye(3)
    return se3.transform(R, np.median(b - a @ R.T, axis=0))


def stated_noise(obs: Observations) -> NoiseEstimate:
    """Stated noise of the instrument where there is one, and the repeatability turned into angles at the arm's reach.

    It is the prior of the variance components, and the noise under which the geometry is fitted first.
    """
    robot = obs.cell.robot
    reach = max(float(np.sum(np.hypot(robot.chain.a, robot.chain.d))), 1.0)
    point = np.full(3, OPTIONS.initial_point_mm) if obs.cell.noise_mm is None else np.maximum(obs.cell.noise_mm, 1e-4)
    repeatability = robot.repeatability_mm or OPTIONS.initial_repeatability_mm
    return NoiseEstimate(point, np.full(robot.n, repeatability / 4 / reach), 1e-4)


def gauss_newton_fit(
    obs: Observations, noise: NoiseEstimate, state: CellState | None = None, rounds: int = 20
) -> tuple[CellState, np.ndarray]:
    """Fitted state and (M,) bool of the centres kept; gross outliers are judged anew in every round.

    Raises CalibrationError where the recording does not belong to this robot.
    """
    keep = np.ones(obs.n_centres, bool)
    state = initial_state(obs) if state is None else state
    residual, chi2_before = np.full((obs.n_centres, 3), np.inf), np.inf
    for _ in range(rounds):
        linear = LinearProblem.of(obs, state, keep)
        whiten = linear.whitener(noise)
        columns, sigma, layout = linear.nuisance()
        step = ridge_solve(whiten(columns), whiten(linear.residual), sigma)
        state = linear.moved(step, layout)
        prediction = forward_model.predict(obs, state)
        residual = forward_model.residual(obs, prediction)
        new_keep = reconsider_stations(obs, without_gross_outliers(obs, residual), residual, prediction)
        chi2 = float(np.sum(whiten(residual) ** 2))
        converged = abs(chi2_before - chi2) < 1e-4 * chi2 + 0.1 and np.array_equal(new_keep, keep)
        keep, chi2_before = new_keep, chi2
        if converged:
            break
    require_matching_robot(obs, residual, keep)
    return state, keep


def require_matching_robot(obs: Observations, residual: np.ndarray, keep: np.ndarray) -> None:
    """Raise CalibrationError where the residual (M, R) after the fit is beyond any arm's errors."""
    apart = float(np.median(np.linalg.norm(residual[keep, :3], axis=1))) if keep.any() else 0.0
    if not apart < OPTIONS.wrong_robot_mm:
        raise CalibrationError(
            f"after the geometry was fitted the centres are still {apart:.0f} mm off: the recording does not belong to this robot; "
            f"check unit (deg), order and signs of the joint angles, the links of '{obs.cell.robot.name}' and the certificate"
        )


def ridge_solve(J: np.ndarray, r: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Least squares with a zero-mean prior of the given sigma on each parameter."""
    scaled = J * sigma
    normal = scaled.T @ scaled
    normal[np.diag_indices_from(normal)] += 1.0
    return sigma * np.linalg.solve(normal, scaled.T @ r)


def without_gross_outliers(obs: Observations, residual: np.ndarray) -> np.ndarray:
    """(M,) bool of the centres that are not grossly off, in distance and, of poses of several centres, from their common offset."""
    distance = np.linalg.norm(residual[:, :3], axis=1)
    keep = distance < gross_outlier_limit(distance)
    if residual.shape[1] == 6:
        angle = np.linalg.norm(residual[:, 3:], axis=1)
        keep &= angle < gross_outlier_limit(angle)
    count = np.bincount(obs.pose, minlength=obs.n_poses)
    if np.median(count) >= 3:
        centre = np.stack([_pose_median(obs, residual[:, c]) for c in range(3)], axis=1)
        apart = np.linalg.norm(residual[:, :3] - centre[obs.pose], axis=1)
        several = count[obs.pose] >= 3
        keep &= (apart < gross_outlier_limit(apart[several])) | ~several
    return keep


def reconsider_stations(obs: Observations, keep: np.ndarray, residual: np.ndarray, prediction: forward_model.Prediction) -> np.ndarray:
    """Correct ``keep`` (M,) at stations of which most would be dropped.

    One outlier drags a small station with it; placed by the majority of its centres, the others fit again. Where the majority does not
    fit any placement, the station goes wrong as a whole: that is structure, not outliers, and is kept.
    """
    station, n = obs.station[obs.pose], len(obs.cell.stations)
    count = np.bincount(station, minlength=n)
    share = np.bincount(station, ~keep, n) / np.maximum(count, 1)
    wrong = np.flatnonzero((share > OPTIONS.structural_share) & (count >= OPTIONS.structural_centres))
    if not len(wrong):
        return keep
    keep, far, scale = keep.copy(), gross_outlier_limit(np.linalg.norm(residual[:, :3], axis=1)), np.array(OPTIONS.station_step)
    J = forward_model.station_jacobian(obs, prediction)[:, :3]
    for s in wrong:
        rows = station == s
        A, r, x = J[rows] * scale, residual[rows, :3], np.zeros(6)
        for _ in range(30):  # least absolute distances, by reweighting
            weight = 1.0 / np.maximum(np.linalg.norm(r - A @ x, axis=1), 1e-4)
            normal = np.einsum("mij,m,mik->jk", A, weight, A) + 1e-9 * np.eye(6)
            x = np.linalg.solve(normal, np.einsum("mij,m,mi->j", A, weight, r))
        fits = np.linalg.norm(r - A @ x, axis=1) < far
        keep[rows] = fits if fits.mean() > OPTIONS.structural_share else True
    return keep


def gross_outlier_limit(sizes: np.ndarray) -> float:
    """Size beyond which a residual is a gross outlier: far from the median, and not so common (3 %) that the model must be wrong."""
    return max(8 * float(np.median(sizes)), 1e-9, 1.5 * float(np.quantile(sizes, 0.97)))


def _pose_median(obs: Observations, values: np.ndarray) -> np.ndarray:
    order = np.lexsort((values, obs.pose))
    count = np.bincount(obs.pose, minlength=obs.n_poses)
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, len(values) - 1)
    return values[order][middle]
