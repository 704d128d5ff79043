"""Expected accuracy over the workspace: how uncertain a measured point is, on a grid of places of the base frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.uncertainty import without_rigid_motion
from mbcacq.estimation.identifiability import base_columns, typical_points
from mbcacq.model.json_text import AsJson, Matrix, Vector, as_list


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


def accuracy_map(calibrated: CalibratedCell, cell_mm: float = 250.0, postures: int = 4000, seed: int = 1) -> AccuracyMap:
    """Sample postures within the joint limits, and collect the uncertainty of the point in the middle of what the scanner sees."""
    obs = calibrated.fit.observations
    rng = np.random.default_rng(seed)
    low, high = np.clip(obs.cell.robot.limits, -np.pi, np.pi).T
    q = rng.uniform(low, high, size=(postures, obs.cell.robot.n))
    columns, points = base_columns(calibrated.layout, calibrated.state, q, typical_points(obs)[:1])
    columns = without_rigid_motion(columns, points)
    variance = np.einsum("pig,gh,pih->p", columns, calibrated.covariance, columns, optimize=True)
    place = np.floor(points / cell_mm).astype(int)
    cells, group, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    sigma = np.sqrt(np.bincount(group.ravel(), variance) / count)
    return AccuracyMap(cell_mm=cell_mm, centres_mm=(cells + 0.5) * cell_mm, sigma_mm=sigma, postures=count)
