"""Joint noise against the arm's data sheet, and the single pose that explains it where one does.

One wrong pose of a small recording raises the estimated joint noise so far that no outlier test finds it. With the noise of the data sheet
instead, leaving that pose out takes most of the misfit away, while leaving out any other does not. The change by each deletion follows from
the linearised solution (Cook 1977; Belsley, Kuh, Welsch 1980).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from mbcacq.estimation.noise import first_noise
from mbcacq.estimation.options import Noise
from mbcacq.estimation.outliers import chi2_quantile
from mbcacq.estimation.solution import Solution
from mbcacq.estimation.solver import solve
from mbcacq.model.cell import Cell


@dataclass(frozen=True)
class InfluenceOptions:
    """When joint noise contradicts a data sheet, and when one pose is the reason."""

    noise_factor: float = 3.0  # of the data sheet's: what arms in good order reach under other conditions than the sheet's (load, time)
    false_alarms: float = 1e-3  # nominal level of the test, divided among the poses; the rate itself is not yet measured
    least_difference: float = 20.0  # of chi square to the second pose: odds of e^10; a wrong name is worse than none
    consistent_normal_deviate: float = 4.0  # of the chi square that remains: without the pose, the data sheet's noise must do
    least_dof: int = 6  # that must be left without the pose: fewer explain anything


@dataclass(frozen=True)
class Deletion:
    """The change by leaving a pose out. chi2: (P,) decrease of chi square; rank: (P,) of degrees of freedom; shift: (P, h) of
    parameters."""

    chi2: np.ndarray
    rank: np.ndarray
    shift: np.ndarray


def deletions(solution: Solution, which: np.ndarray) -> Deletion:
    """Deletion of each pose, in the order of the observations, by the linearised solution. which: (h,) indices of parameters."""
    normal, rows, X = solution.normal, solution.normal.rows, solution.X
    g = normal.size
    A, y = normal.reduce(X[..., :g], X[..., g : g + 6])
    residual = X[..., -1]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.information), 1e-300))
    covariance = scale[:, None] * np.linalg.pinv(scale[:, None] * normal.information * scale, hermitian=True) * scale
    gain = covariance @ np.swapaxes(A, 1, 2)  # (P, g, m)
    value, vector = np.linalg.eigh(np.eye(A.shape[1]) - A @ gain - y @ np.swapaxes(y, 1, 2))
    # A direction that the other poses do not determine (no redundancy) stays as it is when the pose is left out.
    kept = value > 1e-6
    along = np.einsum("pmk,pm->pk", vector, residual) * kept
    weighted = along / np.where(kept, value, 1.0)
    shift = -np.einsum("phm,pmk,pk->ph", gain[:, which], vector, weighted)
    out = Deletion(np.zeros(rows.n_poses), np.zeros(rows.n_poses), np.zeros((rows.n_poses, len(which))))
    out.chi2[rows.order] = np.sum(along * weighted, axis=1)
    used = np.any(X != 0.0, axis=2).sum(axis=1)
    out.rank[rows.order] = np.maximum(used - (~kept).sum(axis=1), 0)
    out.shift[rows.order] = shift
    return out


def joint_factor(noise: Noise, cell: Cell) -> float:
    """The joints' noise in units of what the arm's data sheet, or its class, allows; the median over the joints."""
    return float(np.median(noise.joint / first_noise(cell).joint))


def joint_noise_check(
    solution: Solution, noise: Noise, covariance: np.ndarray, options: InfluenceOptions | None = None
) -> dict[str, Any] | None:
    """Where the estimated joint noise is far beyond the arm's data sheet: by what factor, and the pose that explains it if one does.

    covariance: (g, g) of the parameters, as stated. None where the noise is credible or the data sheet is silent.
    """
    options, obs, names = options or InfluenceOptions(), solution.lineariser.obs, solution.lineariser.layout.names
    allowed = first_noise(obs.cell).joint
    factor = joint_factor(noise, obs.cell)
    if not obs.cell.robot.repeatability_mm or factor <= options.noise_factor:
        return None
    found: dict[str, Any] = {"joint_factor": factor, "allowed_joint_rad": allowed.tolist(), "pose": None}
    strict = solve(solution, replace(noise, joint=allowed), tolerance=1e-2)
    hand_eye = np.array([i for i, name in enumerate(names) if name.startswith("hand_eye.")], dtype=int)
    if (pose := _explaining_pose(strict, deletions(strict, hand_eye), options)) is None:
        return found
    shift = deletions(solution, hand_eye).shift[pose]
    std = np.sqrt(np.diag(covariance))[hand_eye]
    found["pose"] = int(obs.pose_id[pose])
    found["hand_eye_shift"] = dict(zip((names[i] for i in hand_eye), shift.tolist(), strict=True))
    found["hand_eye_sigmas"] = float(np.max(np.abs(shift) / std)) if len(hand_eye) else 0.0
    return found


def _explaining_pose(strict: Solution, deleted: Deletion, options: InfluenceOptions) -> int | None:
    """Index of the pose whose deletion takes most of the misfit away, by an F test; None where there is none."""
    weights, lineariser = strict.weights, strict.lineariser
    used = weights.centre * weights.pose[lineariser.obs.pose]
    dof = lineariser.rows.width * float(used.sum()) + strict.prior.rows - lineariser.layout.size - int(strict.normal.station_rank.sum())
    rest_dof = dof - deleted.rank
    judged = (deleted.rank > 0) & (rest_dof >= options.least_dof)
    if not judged.any():
        return None
    rest = np.maximum(strict.cost - deleted.chi2, 1e-300) / np.maximum(rest_dof, 1.0)
    ratio = np.where(judged, deleted.chi2 / np.maximum(deleted.rank, 1.0) / rest, 0.0)
    p_value = fdtrc(np.maximum(deleted.rank, 1.0), np.maximum(rest_dof, 1.0), ratio)
    p_value = np.where(judged, p_value, 1.0)
    pose = int(np.argmin(p_value))
    left = strict.cost - deleted.chi2
    others = np.delete(left, pose)
    decided = others.size == 0 or others.min() - left[pose] > options.least_difference
    consistent = left[pose] < chi2_quantile(rest_dof[pose], options.consistent_normal_deviate)
    return pose if p_value[pose] < options.false_alarms / judged.sum() and decided and consistent else None


def joint_noise_sentence(found: dict[str, Any]) -> str:
    """The warning for a person."""
    text = f"The estimated joint noise is {found['joint_factor']:.1f} times what the arm's data sheet (repeatability_mm) allows"
    if found["pose"] is None:
        return f"{text}; something is not in the model, or poses do not belong to it. mbcacq diagnose looks for it."
    return (
        f"{text}. Look at pose {found['pose']} first: without it most of the misfit vanishes, and the hand-eye moves by "
        f"{found['hand_eye_sigmas']:.1f} of its stated standard uncertainties. Measure it again before it is left out."
    )
