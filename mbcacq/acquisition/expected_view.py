"""Ball centres of one pose: where the plan predicts them, and the mean of those found in its exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.plan import PlannedPose
from mbcacq.spheres.found import FoundSpheres


@dataclass(frozen=True)
class MeanCentres:
    """Centres of a pose: ball (k,) ids, xyz (k, 3) mm mean over the exposures that show the ball, scatter (k, 3) mm between them."""

    ball: np.ndarray
    xyz: np.ndarray
    n_points: np.ndarray
    rms_mm: np.ndarray
    scatter_mm: np.ndarray


def mean_centres(found: Sequence[FoundSpheres]) -> MeanCentres:
    """Average the exposures of one pose. A ball counts only if it was found in at least half of them."""
    ids = np.concatenate([f.ball for f in found]) if found else np.zeros(0, int)
    xyz = np.concatenate([f.xyz for f in found]) if found else np.zeros((0, 3))
    n_points = np.concatenate([f.n_points for f in found]) if found else np.zeros(0)
    rms = np.concatenate([f.rms_mm for f in found]) if found else np.zeros(0)
    ball, index, count = np.unique(ids, return_inverse=True, return_counts=True)
    total = np.zeros((len(ball), 3))
    np.add.at(total, index, xyz)
    mean = total / count[:, None]
    square = np.zeros_like(total)
    np.add.at(square, index, (xyz - mean[index]) ** 2)
    scatter = np.sqrt(square / np.maximum(count - 1, 1)[:, None])
    keep = 2 * count >= len(found)
    weight = np.bincount(index, n_points, len(ball)) / count
    spread = np.sqrt(np.bincount(index, rms**2, len(ball)) / count)
    return MeanCentres(ball[keep], mean[keep], np.rint(weight[keep]).astype(int), spread[keep], scatter[keep])


def predicted_centres(cell: Cell, pose: PlannedPose) -> np.ndarray:
    """Where the plan expects the balls of a pose: (k, 3) mm in the scanner frame, in the order of ``pose.balls``."""
    artefact = cell.artefact(pose.artefact)
    T_base_scanner = cell.robot.chain.flange(pose.q[None])[0] @ cell.T_flange_scanner
    centres = artefact.centres[[artefact.ball_ids.index(b) for b in pose.balls]]
    return se3.apply(se3.inverse(T_base_scanner) @ cell.station(pose.station).planned_pose, centres)
