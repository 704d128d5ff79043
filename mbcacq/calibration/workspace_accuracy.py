"""Accuracy over the workspace: how uncertain a measured point is, and how observable the parameters are by a set of poses.

Observability is given by the indices O1 to O5, from the scaled information of the arm and the hand-eye. O1 (Borm, Menq 1991): geometric
mean of the singular values over sqrt(m). O2 (Driels, Pathre 1990): inverse condition number. O3 (Nahvi, Hollerbach, Hayward 1994): smallest
singular value. O4 (Nahvi, Hollerbach 1996): noise amplification, O3 squared over the largest. O5 (Sun, Hollerbach 2008): inverse of the sum
of inverses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.estimation.identifiability import typical_points, workspace_information
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.geometry import se3
from mbcacq.model.json_text import AsJson, Matrix, Vector, as_list
from mbcacq.model.observations import Observations


def indices(information: np.ndarray, scale: np.ndarray, count: int) -> dict[str, float]:
    """O1..O5 of a reduced information matrix (g, g) whose parameters have the plausible sizes ``scale`` (g,), from ``count`` poses.

    The larger, the better, for each. A singular matrix, and one without parameters, has O1 to O5 of zero.
    """
    value = np.linalg.eigvalsh(scale[:, None] * information * scale)
    singular = np.sqrt(np.maximum(value, 0.0))
    if not len(singular) or singular[0] <= 1e-9 * singular[-1]:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    least, largest = singular[0], singular[-1]
    mean, harmonic = np.exp(np.mean(np.log(singular))) / np.sqrt(count), 1.0 / np.sum(1.0 / singular)
    return {f"O{i}": float(index) for i, index in enumerate((mean, least / largest, least, least**2 / largest, harmonic), 1)}


def arm_indices(layout: ParameterLayout, covariance: np.ndarray, poses: int) -> dict[str, float]:
    """O1..O5 of the kinematic and hand-eye parameters, from so many poses, by the covariance (g, g) of all free parameters: the others are
    free as they were."""
    arm = int(layout.blocks[0].free.sum() + layout.blocks[1].free.sum())
    scale = layout.scale[:arm]
    covariance = covariance[:arm, :arm] / scale / scale[:, None]
    if np.linalg.matrix_rank(covariance, hermitian=True) < arm:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    return indices(np.linalg.inv(covariance), np.ones(arm), poses)


@dataclass(frozen=True, kw_only=True)
class AccuracyMap(AsJson):
    """Uncertainty of a point over the reach of the arm.

    Attributes
    ----------
    cell_mm : float
        Edge length of a cell.
    centres_mm : Matrix
        (C, 3) of the cells that are reached.
    sigma_mm : Vector
        (C,) 3D standard uncertainty of a point, rms over the postures that get there, a rigid motion of the whole base aside.
    postures : Annotated[ndarray, as_list(list[int])]
        (C,) how many were tried there.
    """

    cell_mm: float
    centres_mm: Matrix
    sigma_mm: Vector
    postures: Annotated[np.ndarray, as_list(list[int])]


def accuracy_map(cell: CellEstimate, obs: Observations, cell_mm: float = 250.0, postures: int = 4000, seed: int = 1) -> AccuracyMap:
    """Sample postures within the joint limits, and collect the uncertainty of the point in the middle of what ``obs`` saw."""
    rng = np.random.default_rng(seed)
    low, high = np.clip(obs.cell.robot.limits, -np.pi, np.pi).T
    q = rng.uniform(low, high, size=(postures, obs.cell.robot.n))
    xyz = np.tile(typical_points(obs)[:1], (postures, 1))
    points = cell.placed(q, xyz)
    variance = np.sum(without_rigid_motion(cell.point_errors(q, xyz), points) ** 2, axis=(1, 2))
    place = np.floor(points / cell_mm).astype(int)
    cells, group, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    sigma = np.sqrt(np.bincount(group.ravel(), variance) / count)
    return AccuracyMap(cell_mm=cell_mm, centres_mm=(cells + 0.5) * cell_mm, sigma_mm=sigma, postures=count)


def expected_accuracy(cell: CellEstimate, obs: Observations, postures: int, seed: int) -> float:
    """See ``CalibratedCell.expected_accuracy``. obs: those that it was calibrated from."""
    if not cell.effects:
        information = workspace_information(obs, cell.state, cell.layout, postures, seed)
        return float(np.sqrt(max(np.sum(information * cell.covariance), 0.0)))
    seen = typical_points(obs)
    low, high = cell.state.chain.drawn_between(obs.cell.robot.limits)
    drawn = np.random.default_rng(seed).uniform(low, high, size=(postures, obs.cell.robot.n))
    q, xyz = np.repeat(drawn, len(seen), axis=0), np.tile(seen, (postures, 1))
    A = without_rigid_motion(cell.point_errors(q, xyz), cell.placed(q, xyz))
    return float(np.sqrt(np.sum(A**2) / len(q)))


def without_rigid_motion(A: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivatives A (P, 3, g) of points (P, 3) mm less the rigid motion of all points together that explains each column best: the base
    is wherever the stations put it."""
    rigid = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -1e-3 * se3.skew(points)], axis=2).reshape(-1, 6)
    flat = A.reshape(-1, A.shape[2])
    normal = np.linalg.pinv(rigid.T @ rigid, rcond=1e-12, hermitian=True)  # well-conditioned, and far quicker than a decomposition of rigid
    return A - (rigid @ (normal @ (rigid.T @ flat))).reshape(A.shape)
