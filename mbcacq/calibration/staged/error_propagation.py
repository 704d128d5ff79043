"""Error propagation: the noise of every pose carried through the least squares of the distance constraint.

Distances are not independent. Each centre enters many of them, the angle adjustment ties the centres of a scan, and the repeatability of
the joints moves all of them together. Plain least squares of the distances understates the uncertainty several times. The method itself has
no noise model, so the hierarchical one is used, with its two levels taken from the same data. The scanner's level follows from the shape of
each scan against the certificate, the joints' from the errors of the distances beyond that (method of moments).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from mbcacq.calibration.staged.ball_pairs import PairDistances
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import LEAST_POINT
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class Measured:
    """The noise of the centres used.

    Attributes
    ----------
    shape : ndarray
        (3,) mm, its sigma along the scanner's axes.
    smoother : tuple[ndarray, ...] or None
        Per pose, what became of the noise of its centres (3 B, 3 B), in the order of the centres, or None: they were not adjusted.
    """

    shape: np.ndarray
    smoother: tuple[np.ndarray, ...] | None = None


@dataclass(frozen=True)
class Propagated:
    """covariance: (g, g) of the parameters; noise: what was found and used."""

    covariance: np.ndarray
    noise: Noise


def scanner_noise(obs: Observations) -> np.ndarray:
    """(3,) mm: sigma of a centre along the scanner's axes, from the shape of each scan against the certificate; as the stated
    noise among the axes, or alike. Poses with fewer than three balls are not used."""
    stated = np.ones(3) if obs.cell.noise_mm is None else np.maximum(obs.cell.noise_mm, LEAST_POINT)
    T = se3.fit_rigid_transforms(obs.cell.ball_centres[obs.ball], obs.xyz, obs.pose, obs.n_poses)
    known = se3.apply(T[obs.pose], obs.cell.ball_centres[obs.ball])
    squares, expected = 0.0, 0.0
    for p in np.flatnonzero(np.bincount(obs.pose, minlength=obs.n_poses) >= 3):
        rows = obs.pose == p
        around = known[rows] - known[rows].mean(axis=0)
        rigid = np.concatenate([np.tile(np.eye(3), (len(around), 1, 1)), -se3.skew(around)], axis=2).reshape(-1, 6)
        U, size, _ = np.linalg.svd(rigid / np.linalg.norm(rigid, axis=0), full_matrices=False)
        U = U[:, size > 1e-6]
        e = (obs.xyz[rows] - known[rows]).reshape(-1)
        squares += float(np.sum((e - U @ (U.T @ e)) ** 2))
        expected += float(np.sum((1 - np.sum(U**2, axis=1)) * np.tile(stated**2, len(around))))
    return np.maximum(np.sqrt(squares / expected) * stated, LEAST_POINT) if expected > 0 else np.full(3, 0.02)


def propagate(
    chain: Chain,
    hand_eye: np.ndarray,
    obs: Observations,
    at: PairDistances,
    J: np.ndarray,
    residual: np.ndarray,
    inverse: np.ndarray,
    measured: Measured,
) -> Propagated:
    """Covariance of the least squares J x = residual, J (K, g), of the distances; inverse: (g, g) of J' J, zero where unobservable."""
    q, pose, xyz = obs.q, obs.pose, obs.xyz
    frames = chain.frames(q)
    T = frames[:, -1] @ hand_eye
    point = se3.apply(T[pose], xyz)
    apart = point[at.a] - point[at.b]
    u = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    rows, count = np.arange(len(at.a)), len(pose)
    D = csr_array(
        (
            np.concatenate([u, -u]).ravel(),
            (np.repeat(np.concatenate([rows, rows]), 3), (3 * np.concatenate([at.a, at.b])[:, None] + np.arange(3)).ravel()),
        ),
        shape=(len(rows), 3 * count),
    )
    S = (D.T @ J).reshape(count, 3, -1)
    weight = np.zeros((count, 3, 3))
    square = u[:, :, None] * u[:, None, :]
    for ends in (at.a, at.b):
        weight += np.stack([np.bincount(ends, square.reshape(-1, 9)[:, c], count) for c in range(9)], axis=1).reshape(-1, 3, 3)
    twists = chain.joint_twists(frames)[pose]
    joint = np.swapaxes(twists[..., :3] + np.cross(twists[..., 3:], point[:, None]), 1, 2)  # (M, 3, n)
    by_scanner, scanner_trace = _scanner(pose, T[pose, :3, :3], S, weight, measured)
    by_pose = np.zeros((len(q), joint.shape[2], S.shape[2]))
    np.add.at(by_pose, pose, np.swapaxes(joint, 1, 2) @ S)
    by_joint = np.einsum("png,pnh->gh", by_pose, by_pose)
    joint_trace = float(np.einsum("mik,mij,mjk->", joint, weight, joint))
    # E |residual|^2 = tr(D Omega D') less what the fit takes of it.
    expected_scanner = scanner_trace - np.sum(inverse * by_scanner)
    expected_joint = joint_trace - np.sum(inverse * by_joint)
    variance = max(float(residual @ residual) - expected_scanner, 0.0) / expected_joint if expected_joint > 0 else 0.0
    covariance = inverse @ (by_scanner + variance * by_joint) @ inverse
    return Propagated(covariance, Noise(measured.shape, np.full(chain.n, np.sqrt(variance))))


def _scanner(pose: np.ndarray, R: np.ndarray, S: np.ndarray, weight: np.ndarray, measured: Measured) -> tuple[np.ndarray, float]:
    """(g, g) sum over poses of S' Omega S, and the trace of ``weight`` Omega, for the scanner's noise. R: (M, 3, 3) scanner in base."""
    S = np.swapaxes(R, 1, 2) @ S
    weight = np.swapaxes(R, 1, 2) @ weight @ R
    if measured.smoother is None:
        weighed = measured.shape[:, None] * S
        return np.einsum("mcg,mch->gh", weighed, weighed), float(np.einsum("mcc,c->", weight, measured.shape**2))
    total, trace = np.zeros((S.shape[2],) * 2), 0.0
    for p in np.unique(pose):
        rows = np.flatnonzero(pose == p)
        A = measured.smoother[p] * np.tile(measured.shape, len(rows))
        own = A.T @ S[rows].reshape(-1, S.shape[2])
        total += own.T @ own
        blocks = A.reshape(len(rows), 3, -1)
        trace += float(np.einsum("mci,mcd,mdi->", blocks, weight[rows], blocks))
    return total, trace
