"""Projection of what columns with normal priors absorb."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.estimation.normal_equations import inverse_of_lower


def ridge_projection(own: np.ndarray, rows_of: Sequence[slice | np.ndarray], shared: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance absorb, and log det(Z'Z + I).

    The z columns Z are those of every station, six each, and the g of ``shared`` (rows, g), which all rows share. own: (rows, 6) columns of
    each row's own station, which vanish at the rows of all others; rows_of: the rows of each station.
    """
    first, g = own.shape[1] * len(rows_of), shared.shape[1]
    Q, beyond, log_det = np.zeros((len(own), first + g)), shared.copy(), 0.0
    normal = np.zeros((g, g))
    for j, rows in enumerate(rows_of):
        inverse, log = _inverse_root(own[rows].T @ own[rows])
        here = own[rows] @ inverse.T
        absorbed = here.T @ shared[rows]
        beyond[rows] -= here @ absorbed
        # With R the inverse root, I - Q'Q = R R': what remains of the normal matrix is a sum of squares, which no rounding makes negative.
        held = inverse.T @ absorbed
        normal += held.T @ held
        Q[rows, 6 * j : 6 * j + 6] = here
        log_det += log
    inverse, log = _inverse_root(normal + beyond.T @ beyond)
    Q[:, first:] = beyond @ inverse.T
    return Q, log_det + log


def _inverse_root(normal: np.ndarray) -> tuple[np.ndarray, float]:
    """R (k, k), lower triangular, with R (I + normal) R' = I, and the log determinant of I + normal."""
    factor = np.linalg.cholesky(normal + np.eye(len(normal)))
    return inverse_of_lower(factor), 2 * float(np.log(np.diag(factor)).sum())
