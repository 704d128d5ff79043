"""Whitening: rows made independent and of unit variance by the hierarchical noise of a recording.

Every centre has instrument noise; every pose has joint repeatability, which moves all its centres together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.forward_model import Prediction
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class NoiseEstimate:
    """point: (3,) mm sigma of a centre along the instrument's axes; joint: (n,) rad; rotation: rad, of a measured orientation."""

    point: np.ndarray
    joint: np.ndarray
    rotation: float = 1e-4

    def rows(self, width: int) -> np.ndarray:
        """(R,) sigma of the rows of one centre."""
        return self.point if width == 3 else np.concatenate([self.point, np.full(3, self.rotation)])


def joint_columns(obs: Observations, prediction: Prediction) -> np.ndarray:
    """(M, R, n): change of the prediction by each joint's angle."""
    twists = obs.cell.robot.chain.joint_twists(prediction.frames)
    return prediction.gradient @ np.swapaxes(twists, -1, -2)[obs.pose]


class Whitener:
    """Multiplies the rows of each pose by the inverse Cholesky factor of its covariance. keep: (M,) bool; other centres have rows 0."""

    def __init__(self, obs: Observations, joint: np.ndarray, noise: NoiseEstimate, keep: np.ndarray):
        self.keep = keep
        self.shape = joint.shape[:2]
        self.groups = []
        width = joint.shape[1]
        variance = noise.rows(width) ** 2
        kept = np.flatnonzero(keep)
        pose = obs.pose[kept]
        first = np.flatnonzero(np.r_[True, np.diff(pose) > 0]) if len(pose) else np.zeros(0, int)
        count = np.diff(np.r_[first, len(pose)])
        self.log_det = 0.0
        for m in np.unique(count):
            index = kept[first[count == m][:, None] + np.arange(m)]
            J = joint[index].reshape(len(index), m * width, -1) * noise.joint
            S = J @ np.swapaxes(J, -1, -2)
            S[:, np.arange(m * width), np.arange(m * width)] += np.tile(variance, m)
            L = np.linalg.cholesky(S)
            self.log_det += 2 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum()
            self.groups.append((index, np.linalg.inv(L)))

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """(M, R) or (M, R, k) -> (M R,) or (M R, k), dropped centres 0."""
        flat = columns if columns.ndim == 3 else columns[..., None]
        out = np.zeros(flat.shape)
        for index, inverse in self.groups:
            size = len(index), -1, flat.shape[2]
            out[index] = (inverse @ flat[index].reshape(size)).reshape(*index.shape, flat.shape[1], flat.shape[2])
        out = out.reshape(-1, flat.shape[2])
        return out if columns.ndim == 3 else out[:, 0]

    def transpose(self, rows: np.ndarray) -> np.ndarray:
        """W' applied to whitened rows (M R,) or (M R, k) -> (M, R) or (M, R, k)."""
        flat = rows.reshape(*self.shape, -1)
        out = np.zeros(flat.shape)
        for index, inverse in self.groups:
            part = np.swapaxes(inverse, -1, -2) @ flat[index].reshape(len(index), -1, flat.shape[2])
            out[index] = part.reshape(*index.shape, flat.shape[1], flat.shape[2])
        return out if rows.ndim == 2 else out[..., 0]

    def row_norms(self) -> np.ndarray:
        """(M, R): diagonal of W'W, the inverse covariance's diagonal."""
        out = np.zeros(self.shape)
        for index, inverse in self.groups:
            out[index] = np.sum(inverse**2, axis=1).reshape(*index.shape, self.shape[1])
        return out
