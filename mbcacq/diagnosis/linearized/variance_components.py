"""Noise of a recording, estimated from the data: restricted maximum likelihood (REML) of variance components with log-normal priors.

Components: instrument noise along each axis (with a measured orientation: its rotational noise too) and repeatability of each joint, which
moves all centres of a pose together. Stated figures and the repeatability on the data sheet are priors, not truths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate, Whitener
from mbcacq.diagnosis.options import OPTIONS


def restricted_maximum_likelihood(
    linear: LinearProblem, columns: np.ndarray, sigma: np.ndarray, start: NoiseEstimate, prior: NoiseEstimate, rounds: int = 12
) -> NoiseEstimate:
    """Most probable noise given that ``columns`` (M, R, z; prior sigma (z,)) explain what is not noise.

    Fisher scoring with the average information matrix (Gilmour, Thompson, Cullis 1995), on logarithms of the sigmas.
    """
    n, oriented = len(start.joint), linear.width == 6
    theta = pack(start, oriented)
    centre = pack(prior, oriented)
    precision = prior_precision(n, oriented, linear.obs.cell.noise_mm is not None)
    highest = upper_limits(linear, centre)
    for _ in range(rounds):
        noise = unpack(theta, n, oriented)
        score, information = _score(linear, columns, sigma, noise)
        score = score - precision @ (theta - centre)
        step = np.linalg.solve(information + precision, score)
        theta = np.clip(theta + np.clip(step, -1.0, 1.0), centre - 4.0, highest)
        if np.abs(step).max() < 0.02:
            break
    return unpack(theta, n, oriented)


def upper_limits(linear: LinearProblem, centre: np.ndarray) -> np.ndarray:
    """Largest log sigmas, by the prior's ``centre``: neither a joint nor an instrument may absorb unexplained structure as noise."""
    cell, joints = linear.obs.cell, slice(3, 3 + linear.obs.cell.robot.n)
    highest = centre + 6.0
    if linear.obs.n_poses > OPTIONS.many_poses:
        highest[joints] = centre[joints] + np.log(OPTIONS.worst_joint)
        return highest
    if cell.noise_mm is not None:
        highest[:3] = centre[:3] + np.log(OPTIONS.worst_point)
    if cell.robot.repeatability_mm:
        highest[joints] = centre[joints] + np.log(OPTIONS.worst_stated)
    return highest


def log_prior(noise: NoiseEstimate, prior: NoiseEstimate, linear: LinearProblem) -> float:
    """Log density of the noise under its prior, up to a constant."""
    oriented = linear.width == 6
    off = pack(noise, oriented) - pack(prior, oriented)
    return -0.5 * float(off @ prior_precision(len(prior.joint), oriented, linear.obs.cell.noise_mm is not None) @ off)


def pack(noise: NoiseEstimate, oriented: bool) -> np.ndarray:
    """Logarithms of the sigmas: three axes, n joints and, with a measured orientation, its rotation."""
    return np.log(np.concatenate([noise.point, noise.joint, [noise.rotation] if oriented else []]))


def unpack(theta: np.ndarray, n: int, oriented: bool) -> NoiseEstimate:
    """The noise of such logarithms."""
    value = np.exp(theta)
    return NoiseEstimate(value[:3], value[3 : 3 + n], float(value[-1]) if oriented else 1e-4)


def prior_precision(n: int, oriented: bool, stated: bool) -> np.ndarray:
    """Inverse covariance of the log sigmas. Joints share an unknown common level and differ from it a little; so do the axes of an
    instrument of which nothing is stated.
    """
    o, size = OPTIONS, 3 + n + oriented
    out = np.zeros((size, size))
    out[:3, :3] = np.eye(3) / o.log_sd_stated**2 if stated else np.linalg.inv(o.log_sd_axis**2 * np.eye(3) + o.log_sd_guessed**2)
    out[3 : 3 + n, 3 : 3 + n] = np.linalg.inv(o.log_sd_joint**2 * np.eye(n) + o.log_sd_common**2)
    if oriented:
        out[-1, -1] = 1 / o.log_sd_guessed**2
    return out


def _score(linear: LinearProblem, columns: np.ndarray, sigma: np.ndarray, noise: NoiseEstimate) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and average information of the restricted log likelihood by the log sigmas."""
    whiten = linear.whitener(noise)
    Q, _ = ridge_projection(whiten(columns) * sigma)
    r = whiten(linear.residual)
    r = r - Q @ (Q.T @ r)
    by_pose = PoseSums.of(linear)
    y, score = [], []
    transposed = whiten.transpose(r), whiten.transpose(Q), whiten.row_norms()
    for c in range(4 if linear.width == 6 else 3):
        value, trace, image = _row_component(linear, whiten, transposed, c, noise)
        score.append(value - trace)
        y.append(image)
    joints = whiten(linear.joint * noise.joint)
    for j in range(joints.shape[1]):
        z = joints[:, j]
        b = by_pose(z * r)
        absorbed = by_pose(z[:, None] * Q)
        trace = by_pose(z * z).sum() - np.sum(absorbed**2)
        score.append(np.sum(b**2) - trace)
        y.append(z * b[by_pose.pose_of_row])
    Y = np.stack(y, axis=1)
    absorbed = Q.T @ Y
    return np.array(score), 2 * (Y.T @ Y - absorbed.T @ absorbed)


def _row_component(
    linear: LinearProblem, whiten: Whitener, transposed: tuple[np.ndarray, np.ndarray, np.ndarray], c: int, noise: NoiseEstimate
) -> tuple[float, float, np.ndarray]:
    """r'PKPr, tr(PK) and W K W' r for K = variance of axis c (c = 3: the three rotational rows).

    transposed: W'r, W'Q and the diagonal of W'W.
    """
    rows = slice(c, c + 1) if c < 3 else slice(3, 6)
    level = noise.point[c] if c < 3 else noise.rotation
    r, Q, norms = transposed
    value = level**2 * float(np.sum(r[:, rows] ** 2))
    trace = level**2 * (norms[:, rows].sum() - float(np.sum(Q[:, rows] ** 2)))
    image = np.zeros((linear.obs.n_centres, linear.width))
    image[:, rows] = r[:, rows] * level**2
    return value, trace, whiten(image)


def ridge_projection(Z: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance absorb, and log det(Z'Z + I)."""
    normal = Z.T @ Z
    normal[np.diag_indices_from(normal)] += 1.0
    factor = np.linalg.cholesky(normal)
    return Z @ inverse_of_lower(factor).T, 2 * float(np.log(np.diag(factor)).sum())


def inverse_of_lower(factor: np.ndarray) -> np.ndarray:
    """Inverse of a lower triangular matrix (k, k)."""
    return dtrtri(factor, lower=1)[0]


@dataclass(frozen=True)
class PoseSums:
    """Sums of rows over each pose. pose_of_row: (M R,) index of the pose; starts: first row of each pose that is measured, ``used``."""

    pose_of_row: np.ndarray
    starts: np.ndarray
    used: np.ndarray
    n_poses: int

    @classmethod
    def of(cls, linear: LinearProblem) -> PoseSums:
        pose = np.repeat(linear.obs.pose, linear.width)
        starts = np.flatnonzero(np.r_[True, np.diff(pose) > 0])
        return cls(pose, starts, pose[starts], linear.obs.n_poses)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(M R, ...) -> (P, ...)."""
        out = np.zeros((self.n_poses, *values.shape[1:]))
        out[self.used] = np.add.reduceat(values, self.starts, axis=0)
        return out
