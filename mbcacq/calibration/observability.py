"""Observability of the parameters by a set of poses: the indices O1 to O5, from the scaled information of the arm and the hand-eye.

O1 (Borm, Menq 1991): geometric mean of the singular values over sqrt(m). O2 (Driels, Pathre 1990): inverse condition number. O3 (Nahvi,
Hollerbach, Hayward 1994): smallest singular value. O4 (Nahvi, Hollerbach 1996): noise amplification, O3 squared over the largest. O5 (Sun,
Hollerbach 2008): inverse of the sum of inverses.
"""

from __future__ import annotations

import numpy as np

from mbcacq.estimation.parameters import ParameterLayout


def indices(information: np.ndarray, scale: np.ndarray, count: int) -> dict[str, float]:
    """O1..O5 of a reduced information matrix (g, g) whose parameters have the plausible sizes ``scale`` (g,), from ``count`` poses.

    The larger, the better, for each. A singular matrix, and one without parameters, has O1 to O5 of zero.
    """
    value = np.linalg.eigvalsh(scale[:, None] * information * scale)
    singular = np.sqrt(np.maximum(value, 0.0))
    if not len(singular) or singular[0] <= 1e-9 * singular[-1]:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    return {
        "O1": float(np.exp(np.mean(np.log(singular))) / np.sqrt(count)),
        "O2": float(singular[0] / singular[-1]),
        "O3": float(singular[0]),
        "O4": float(singular[0] ** 2 / singular[-1]),
        "O5": float(1.0 / np.sum(1.0 / singular)),
    }


def arm_indices(layout: ParameterLayout, covariance: np.ndarray, poses: int) -> dict[str, float]:
    """O1..O5 of the kinematic and hand-eye parameters, from so many poses, by the covariance (g, g) of all free parameters: the others are
    free as they were."""
    arm = int(layout.blocks[0].free.sum() + layout.blocks[1].free.sum())
    scale = layout.scale[:arm]
    covariance = covariance[:arm, :arm] / scale / scale[:, None]
    if np.linalg.matrix_rank(covariance, hermitian=True) < arm:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    return indices(np.linalg.inv(covariance), np.ones(arm), poses)
