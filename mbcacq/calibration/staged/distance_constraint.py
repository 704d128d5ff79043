"""Joint identification of hand-eye and MD-H errors from certified distances (Eq. 13-24), by Levenberg-Marquardt.

Two balls seen from two poses of one station, brought into the base, are as far apart as the certificate says:
|l_true| - |l_measured| = u' (dp_a - dp_b), with dp = true - measured (Eq. 23 prints the opposite sign). Two balls of one scan say
nothing: any rigid motion keeps their distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.calibration.staged.pair_distances import Measured, PairDistances, points_and_directions, propagate
from mbcacq.calibration.staged.pair_distances import pairs as pairs
from mbcacq.estimation.options import Noise
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations

MOST_STEPS, SETTLED = 50, 1e-9  # steps, and the share of the cost that the last of them still gains
UNOBSERVABLE = 1e-10  # eigenvalue of the scaled normal equations, as a share of the largest, below which a direction counts as unobservable


@dataclass(frozen=True)
class Identified:
    """chain with its errors, hand-eye; rms_before, rms_after: mm of the distances; covariance (g, g) of the free parameters, with
    the noise of ``propagation``, zero in the directions ``unobservable`` (g, u), unit vectors; free: (5 n + 6,) bool."""

    chain: Chain
    T_flange_scanner: np.ndarray
    rms_before: float
    rms_after: float
    covariance: np.ndarray
    noise: Noise
    unobservable: np.ndarray
    free: np.ndarray
    iterations: int


def identify(
    chain: Chain, hand_eye: np.ndarray, obs: Observations, distances: PairDistances, free: np.ndarray, measured: Measured | None = None
) -> Identified:
    """From the centres of ``obs`` and their certified ``distances``. free: (5 n + 6,) bool, MD-H row by row, then the hand-eye twist.

    Redundant parameters may be free: the damping keeps them near their start, as the paper's does. measured: noise of the centres, for
    the covariance (default: 0.02 mm, centres not adjusted).
    """
    damping, scale = 1e-3, np.concatenate([np.tile([1e-3, 1.0, 1.0, 1e-3, 1e-3], chain.n), [1, 1, 1, 5e-3, 5e-3, 5e-3]])[free]
    residual, J = _linearise(chain, hand_eye, obs, distances, free)
    before = cost = float(residual @ residual)
    iterations = 0
    while iterations < MOST_STEPS:
        iterations += 1
        A = scale[:, None] * (J.T @ J) * scale
        b = scale * (J.T @ residual)
        A[np.diag_indices_from(A)] += damping * np.diag(A).max()
        step = scale * np.linalg.solve(A, b)
        full = np.zeros(len(free))
        full[free] = step
        moved = chain.with_errors(full[:-6].reshape(-1, 5)), hand_eye @ se3.exp(full[-6:])
        trial, J_trial = _linearise(*moved, obs, distances, free)
        new = float(trial @ trial)
        if new > cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        gained = cost - new
        (chain, hand_eye), residual, J, cost, damping = moved, trial, J_trial, new, max(damping / 10, 1e-12)
        if gained < SETTLED * cost:
            break
    value, vector = np.linalg.eigh(scale[:, None] * (J.T @ J) * scale)
    observable = value > UNOBSERVABLE * value[-1]
    inverse = scale[:, None] * (vector[:, observable] / value[observable]) @ vector[:, observable].T * scale
    measured = measured or Measured(np.full(3, 0.02))
    covariance, noise = propagate(chain, hand_eye, obs, distances, J, residual, inverse=inverse, measured=measured)
    unobservable = scale[:, None] * vector[:, ~observable]
    unobservable, rms = unobservable / np.linalg.norm(unobservable, axis=0), np.sqrt(np.array([before, cost]) / max(len(residual), 1))
    return Identified(chain, hand_eye, rms[0], rms[1], covariance, noise, unobservable, free=free, iterations=iterations)


def _linearise(
    chain: Chain, hand_eye: np.ndarray, obs: Observations, distances: PairDistances, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residual (K,) true minus measured distance, and its columns (K, g): the derivative of the measured distance."""
    q, pose = obs.q, obs.pose
    frames, T, point, length, u = points_and_directions(chain, hand_eye, obs, distances)
    twists = np.concatenate([chain.parameter_twists(frames, q).reshape(len(q), -1, 6), np.swapaxes(se3.adjoint(T), 1, 2)], axis=1)[:, free]
    moved = twists[pose][..., :3] + np.cross(twists[pose][..., 3:], point[:, None])
    J = np.einsum("kc,kgc->kg", u, moved[distances.a]) - np.einsum("kc,kgc->kg", u, moved[distances.b])
    return distances.certified - length, J
