"""Noise of a recording, estimated from the data: restricted maximum likelihood of variance components with log-normal priors.

Components: instrument noise along each axis (with a measured orientation: its rotational noise too) and repeatability of each joint, which
moves all centres of a pose together. Stated figures and the repeatability on the data sheet are priors, not truths.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtrtri

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate

WORST_POINT, WORST_STATED = 3.0, 8.0  # times the stated noise of an instrument, and what a stated repeatability means at a joint
MANY_POSES, WORST_JOINT = 350, 10.0  # of a long recording no joint is taken to repeat worse than this many times what it should
LOG_SD_STATED, LOG_SD_GUESSED, LOG_SD_AXIS, LOG_SD_COMMON, LOG_SD_JOINT = 0.3, 1.5, 0.35, 1.0, 0.35


def estimate(
    linear: LinearProblem, columns: np.ndarray, sigma: np.ndarray, start: NoiseEstimate, prior: NoiseEstimate, rounds: int = 12
) -> NoiseEstimate:
    """Most probable noise given that ``columns`` (M, R, z; prior sigma (z,)) explain what is not noise.

    Fisher scoring with the average information matrix (Gilmour, Thompson, Cullis 1995), on logarithms of the sigmas.
    """
    n, width = len(start.joint), linear.width
    turn = width == 6
    theta = pack(start, turn)
    centre = pack(prior, turn)
    precision = prior_precision(n, turn, linear.obs.cell.noise_mm is not None)
    highest = centre + 6.0
    if linear.obs.n_poses > MANY_POSES:  # unexplained structure must not make one joint pass for pure noise
        highest[3 : 3 + n] = centre[3 : 3 + n] + np.log(WORST_JOINT)
    else:  # nor may it pass for an instrument, or an arm, far worse than is stated
        if linear.obs.cell.noise_mm is not None:
            highest[:3] = centre[:3] + np.log(WORST_POINT)
        if linear.obs.cell.robot.repeatability_mm:
            highest[3 : 3 + n] = centre[3 : 3 + n] + np.log(WORST_STATED)
    for _ in range(rounds):
        noise = unpack(theta, n, turn)
        score, information = _score(linear, columns, sigma, noise, turn)
        score = score - precision @ (theta - centre)
        step = np.linalg.solve(information + precision, score)
        theta = np.clip(theta + np.clip(step, -1.0, 1.0), centre - 4.0, highest)
        if np.abs(step).max() < 0.02:
            break
    return unpack(theta, n, turn)


def log_prior(noise: NoiseEstimate, prior: NoiseEstimate, linear: LinearProblem) -> float:
    """Log density of the noise under its prior, up to a constant."""
    turn = linear.width == 6
    off = pack(noise, turn) - pack(prior, turn)
    return -0.5 * float(off @ prior_precision(len(prior.joint), turn, linear.obs.cell.noise_mm is not None) @ off)


def pack(noise: NoiseEstimate, turn: bool) -> np.ndarray:
    return np.log(np.concatenate([noise.point, noise.joint, [noise.turn] if turn else []]))


def unpack(theta: np.ndarray, n: int, turn: bool) -> NoiseEstimate:
    value = np.exp(theta)
    return NoiseEstimate(value[:3], value[3 : 3 + n], float(value[-1]) if turn else 1e-4)


def prior_precision(n: int, turn: bool, stated: bool) -> np.ndarray:
    """Joints share an unknown common level (LOG_SD_COMMON) and differ from it by LOG_SD_JOINT; so do the axes of an instrument of which
    nothing is stated, or one of them could hide a mismatch.
    """
    size = 3 + n + turn
    out = np.zeros((size, size))
    out[:3, :3] = np.eye(3) / LOG_SD_STATED**2 if stated else np.linalg.inv(LOG_SD_AXIS**2 * np.eye(3) + LOG_SD_GUESSED**2)
    out[3 : 3 + n, 3 : 3 + n] = np.linalg.inv(LOG_SD_JOINT**2 * np.eye(n) + LOG_SD_COMMON**2)
    if turn:
        out[-1, -1] = 1 / LOG_SD_GUESSED**2
    return out


def _score(
    linear: LinearProblem, columns: np.ndarray, sigma: np.ndarray, noise: NoiseEstimate, turn: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and average information of the restricted log likelihood by the log sigmas."""
    whiten = linear.whitener(noise)
    Q, _ = orthogonal(whiten(columns) * sigma)
    r = whiten(linear.residual)
    r = r - Q @ (Q.T @ r)
    pose_first, by_pose = pose_sums(linear)
    y, score = [], []
    back = whiten.transpose(r), whiten.transpose(Q), whiten.row_norms()
    for c in range(3 + turn):
        value, trace, image = _row_component(linear, whiten, back, c, noise)
        score.append(value - trace)
        y.append(image)
    joints = whiten(linear.joint * noise.joint)
    for j in range(joints.shape[1]):
        z = joints[:, j]
        b = by_pose(z * r)
        taken = by_pose(z[:, None] * Q)
        trace = by_pose(z * z).sum() - np.sum(taken**2)
        score.append(np.sum(b**2) - trace)
        y.append(z * b[pose_first])
    Y = np.stack(y, axis=1)
    taken = Q.T @ Y
    return np.array(score), 2 * (Y.T @ Y - taken.T @ taken)


def _row_component(linear, whiten, back, c, noise):
    """r'PKPr, tr(PK) and W K W' r for K = variance of axis c (c = 3: the three rotational rows). back: W'r, W'Q and the diagonal of W'W."""
    rows = slice(c, c + 1) if c < 3 else slice(3, 6)
    level = noise.point[c] if c < 3 else noise.turn
    r, Q, norms = back
    value = level**2 * float(np.sum(r[:, rows] ** 2))
    trace = level**2 * (norms[:, rows].sum() - float(np.sum(Q[:, rows] ** 2)))
    image = np.zeros((linear.obs.n_centres, linear.width))
    image[:, rows] = r[:, rows] * level**2
    return value, trace, whiten(image)


def orthogonal(Z: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance take away, and log det(Z'Z + I)."""
    normal = Z.T @ Z
    normal[np.diag_indices_from(normal)] += 1.0
    factor = np.linalg.cholesky(normal)
    return Z @ dtrtri(factor, lower=1)[0].T, 2 * float(np.log(np.diag(factor)).sum())


def pose_sums(linear: LinearProblem):
    """(row -> pose index (M R,)) and a function summing rows (M R, ...) over each pose -> (P, ...)."""
    pose = np.repeat(linear.obs.pose, linear.width)
    starts = np.flatnonzero(np.r_[True, np.diff(pose) > 0])
    used = pose[starts]

    def by_pose(values: np.ndarray) -> np.ndarray:
        out = np.zeros((linear.obs.n_poses, *values.shape[1:]))
        out[used] = np.add.reduceat(values, starts, axis=0)
        return out

    return pose, by_pose
