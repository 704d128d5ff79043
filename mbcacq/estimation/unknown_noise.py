"""The covariance of an estimate, averaged over what its noise may be.

Ten poses leave the repeatability of the joints uncertain by a factor of 1.8, and a covariance under the most probable noise is then too
small: it grows with the square of the noise, whose mean lies above the most probable value, and the estimate itself depends on the noise
(Kackar and Harville 1984). Both are averaged over the posterior of the noise's logarithms along its longest axis, which is the level that
the joints share, at points on a grid that weigh what the posterior is there (as Rue, Martino and Chopin 2009 integrate hyper-parameters).
"""

from __future__ import annotations

import numpy as np

from mbcacq.estimation.solution import Solution
from mbcacq.estimation.variance_components import log_restricted_posterior, pack, reml_score_and_information, unpack

# More poses leave less than LEAST_VARIANCE along that axis (seen with arms of six and of seven axes).
FEW_POSES = 64
LEAST_VARIANCE = 0.05  # of a logarithm: it makes a standard deviation 5 % larger
LARGEST_VARIANCE = 0.5  # a grid by a larger one would be too wide for what the posterior is
GRID = np.linspace(-2.25, 3.0, 8)  # standard deviations; the posterior of a small noise has its longer tail where it is larger


def covariance(at: Solution) -> np.ndarray:
    """Covariance of the free parameters.

    Parameters
    ----------
    at : Solution
        Converged, under its most probable noise.

    Returns
    -------
    np.ndarray
        (g, g), mm and rad, as the layout has the parameters.
    """
    if at.lineariser.obs.n_poses > FEW_POSES:
        return under_the_noise(at)
    at = at.evaluated()
    axis = _longest_axis(at)
    return under_the_noise(at) if axis is None else _averaged_along(at, axis)


def under_the_noise(at: Solution) -> np.ndarray:
    """(g, g) covariance of the free parameters if the noise is as the solution has it."""
    scale = at.lineariser.layout.scale
    return scale[:, None] * positive_inverse(scale[:, None] * at.normal.information * scale) * scale


def positive_inverse(H: np.ndarray) -> np.ndarray:
    """Inverse (g, g) of a symmetric matrix that is positive but for rounding: a variance never comes out negative, as it may from a plain
    inverse where the largest and the smallest information are 16 digits apart. Such directions get the variance of the rounding."""
    value, vector = np.linalg.eigh(H)
    return (vector / np.maximum(value, 1e-15 * len(H) * value[-1])) @ vector.T if len(H) else H


def _longest_axis(at: Solution) -> np.ndarray | None:
    """(K,) step of the noise's logarithms, a standard deviation along the longest axis of their posterior; None where that is short."""
    _, information = reml_score_and_information(at.system, at.noise)
    seen = slice(None) if at.lineariser.rows.width > 3 else slice(-1)  # without measured orientations their noise has no part in it
    variances, axes = np.linalg.eigh(np.linalg.inv((information + at.lineariser.noise_prior.precision)[seen, seen]))
    if variances[-1] < LEAST_VARIANCE:
        return None
    step = np.zeros(len(information))
    step[seen] = np.sqrt(min(variances[-1], LARGEST_VARIANCE)) * axes[:, -1]
    return step


def _averaged_along(at: Solution, axis: np.ndarray) -> np.ndarray:
    """(g, g) mean of the covariances along an axis (K,), and covariance of the estimates there."""
    scale, prior = at.lineariser.layout.scale, at.lineariser.noise_prior
    log_density, covariances, steps = [], [], []
    for along in GRID:
        noise = unpack(pack(at.noise) + along * axis)
        there = at.reweighted(noise, at.weights)
        log_density.append(log_restricted_posterior(there.system.after_fit(), noise, prior))
        covariances.append(under_the_noise(there))
        steps.append(there.normal.gauss_newton_step(scale))
    weight = np.exp(np.array(log_density) - max(log_density))
    weight /= weight.sum()
    off = np.array(steps) - weight @ np.array(steps)
    return np.einsum("k,kij->ij", weight, np.array(covariances)) + off.T @ (weight[:, None] * off)
