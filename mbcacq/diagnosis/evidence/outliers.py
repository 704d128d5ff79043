"""Gross outliers, judged with a hypothesis in place.

A centre is normal about its prediction, or with a small probability anywhere within a broad normal distribution. So hypotheses with
different outliers can be compared: every outlier costs the log of that probability density.
"""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import solution
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.estimation.linear_problem import LinearProblem


def log_density_of_outlier(linear: LinearProblem) -> float:
    """Log prior probability of an outlier times its density, without the power of 2 pi that every centre has."""
    size = np.log(OPTIONS.outlier_mm) * 3 + (np.log(OPTIONS.outlier_rad) * 3 if linear.width == 6 else 0.0)
    return float(np.log(OPTIONS.outlier_prior) - size)


def kept_centres(hypothesis: Hypothesis) -> np.ndarray:
    """(M,) bool of the centres that are more probable as measurements than as outliers, by the noise of the instrument and the joints."""
    point = hypothesis.point
    linear, noise = point.linear, point.projected.noise
    _, residual = solution(hypothesis)
    J = linear.rows.unpad(linear.joint * linear.rows.joint_sigma(noise))
    S = J @ np.swapaxes(J, 1, 2)
    S[:, np.arange(linear.width), np.arange(linear.width)] += linear.rows.row_sigma(noise) ** 2
    square = np.einsum("mr,mr->m", residual, np.linalg.solve(S, residual[:, :, None])[:, :, 0])
    log_density = -0.5 * (square + np.linalg.slogdet(S)[1])
    return log_density > log_density_of_outlier(linear)
