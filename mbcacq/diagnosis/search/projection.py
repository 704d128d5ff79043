"""Projection of what columns with normal priors absorb."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dtrtri  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs


def ridge_projection(own: np.ndarray, rows_of: Sequence[slice | np.ndarray], shared: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance absorb, and log det(Z'Z + I).

    The z columns Z are those of every station, six each, and the g of ``shared`` (rows, g), which all rows share. own: (rows, 6) columns of
    each row's own station, which vanish at the rows of all others; rows_of: the rows of each station.
    """
    first = own.shape[1] * len(rows_of)
    Q, beyond, log_det = np.zeros((len(own), first + shared.shape[1])), shared.copy(), 0.0
    for j, rows in enumerate(rows_of):
        here, log = _orthogonal(own[rows], own[rows].T @ own[rows])
        Q[rows, 6 * j : 6 * j + 6] = here
        beyond[rows] -= here @ (here.T @ shared[rows])
        log_det += log
    Q[:, first:], log = _orthogonal(beyond, shared.T @ beyond)
    return Q, log_det + log


def _orthogonal(Z: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, float]:
    """Z (rows, k) times the inverse root of I + its normal matrix (k, k), and the log determinant of that."""
    factor = np.linalg.cholesky((normal + normal.T) / 2 + np.eye(len(normal)))
    return Z @ inverse_of_lower(factor).T, 2 * float(np.log(np.diag(factor)).sum())


def inverse_of_lower(factor: np.ndarray) -> np.ndarray:
    """Inverse of a lower triangular matrix (k, k)."""
    return dtrtri(factor, lower=1)[0]
