"""Projection of what columns with normal priors absorb."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs

from mbcacq.estimation.linear_problem import LinearProblem


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
