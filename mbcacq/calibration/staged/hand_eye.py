"""Preliminary hand-eye transform from one virtual point (Eq. 5-7): rotation from translations, translation from orientations."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import CalibrationError
from mbcacq.geometry import se3


def virtual_points(points: np.ndarray) -> np.ndarray:
    """Barycentres (P, 3) of the balls of each pose (P, B, 3); the paper takes four balls (Eq. 5)."""
    return points.mean(axis=1)


def rotation_from_translations(T_base_flange: np.ndarray, virtual: np.ndarray) -> np.ndarray:
    """R_flange_scanner (3, 3) from poses (P, 4, 4) of equal orientation that see one fixed point at ``virtual`` (P, 3) (Eq. 7).

    R (p_1 - p_i) = R_base_flange' (t_i - t_1), an orthogonal Procrustes problem (SVD, determinant +1), here about the means, so
    that no pose is special. Raises CalibrationError where the translations span less than a plane.
    """
    R = T_base_flange[:, :3, :3]
    moved = np.einsum("pji,pj->pi", R, T_base_flange[:, :3, 3] - T_base_flange[:, :3, 3].mean(axis=0))
    measured = -(virtual - virtual.mean(axis=0))
    spread = np.linalg.svd(measured, compute_uv=False)
    if len(virtual) < 3 or spread[1] < 1.0:
        raise CalibrationError(
            "the translations do not span a plane, which leaves the hand-eye rotation undetermined; "
            "translate along base X, Y and Z by 20 mm and more"
        )
    return se3.nearest_rotation(moved.T @ measured)


def translation_from_orientations(T_base_flange: np.ndarray, virtual: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """t_flange_scanner (3,) mm from poses (P, 4, 4) of different orientation that see one fixed point at ``virtual`` (P, 3).

    (R_i - R_j) t = t_j - t_i + R_j R p_j - R_i R p_i over all pairs, which is least squares about the means. Raises CalibrationError
    where the orientations turn about one axis only.
    """
    R, t = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    point = t + np.einsum("pij,jk,pk->pi", R, rotation, virtual)
    columns = (R - R.mean(axis=0)).reshape(-1, 3)
    size = np.linalg.svd(columns, compute_uv=False)
    if size[-1] < 0.02 * np.sqrt(len(R)):
        raise CalibrationError(
            "the orientations turn too little, or about one axis only, which leaves the hand-eye translation "
            "undetermined; turn about two axes by 10° and more"
        )
    return np.linalg.lstsq(columns, -(point - point.mean(axis=0)).reshape(-1), rcond=None)[0]
