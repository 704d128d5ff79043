"""Projection of what columns with normal priors absorb."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtrtri  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs


def ridge_projection(Z: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance absorb, and log det(Z'Z + I)."""
    normal = Z.T @ Z
    normal[np.diag_indices_from(normal)] += 1.0
    factor = np.linalg.cholesky(normal)
    return Z @ inverse_of_lower(factor).T, 2 * float(np.log(np.diag(factor)).sum())


def inverse_of_lower(factor: np.ndarray) -> np.ndarray:
    """Inverse of a lower triangular matrix (k, k)."""
    return dtrtri(factor, lower=1)[0]
