"""Robust estimation: rejection of gross outliers, by weights of 0 or 1 (Huber's weights would keep them with a share).

Outliers are centres that disagree with their pose (a ball taken for another) and poses that disagree with the rest (a bumped tripod, a
wrong pose). Thresholds follow a robust scale, the median, so that rejection works while the geometry is still coarse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.pose_information import OutlierDistances

# Median and 1e-7 tail of chi square for 3..7 degrees of freedom are interpolated by Wilson and Hilferty's cube root.
TAIL = 5.2


def chi2_quantile(dof: np.ndarray, z: float) -> np.ndarray:
    """Quantile of chi square at the normal deviate z (Wilson, Hilferty 1931)."""
    dof = np.maximum(dof, 1e-9)
    return dof * (1 - 2 / (9 * dof) + z * np.sqrt(2 / (9 * dof))) ** 3


@dataclass(frozen=True)
class Weights:
    """Weight of each centre (M,) and each pose (P,): 1 full, 0 rejected."""

    centre: np.ndarray
    pose: np.ndarray


def reject_outliers(d: OutlierDistances, weights: Weights, pose: np.ndarray) -> Weights:
    """New weights, 0 or 1. pose: (M,) the pose of each centre. The worst of a pose is judged before its companions, which it spoils."""
    n_poses = len(d.pose)
    count = np.bincount(pose, minlength=n_poses)
    centre = np.ones(len(d.centre))
    displaced = np.zeros(n_poses, bool)
    companions = count[pose] > 1
    if companions.any():
        # The scale is that of all, rejected or not: a median of the survivors would shrink from round to round.
        scale = max(np.median(d.centre[companions]) / chi2_quantile(np.array(float(d.centre_dof)), 0.0), 1e-300)
        worst = np.zeros(n_poses)
        np.maximum.at(worst, pose, d.centre)
        off = companions & (d.centre > max(scale, 0.5) * chi2_quantile(np.array(float(d.centre_dof)), TAIL))
        centre[off & (d.centre > 0.25 * worst[pose])] = 0.0
        # Where most of a pose is off, it is the pose that stands elsewhere.
        displaced = np.bincount(pose, centre == 0, minlength=n_poses) > 0.5 * count
        centre[displaced[pose]] = 1.0
    used = np.bincount(pose, centre, minlength=n_poses)
    judged = d.pose_dof > 0
    per_dof = d.pose / chi2_quantile(np.maximum(d.pose_dof, 1.0), 0.0)
    scale = np.median(per_dof[judged]) if judged.any() else 1.0
    out = judged & (d.pose > max(scale, 0.5) * chi2_quantile(np.maximum(d.pose_dof, 1.0), TAIL))
    changed = np.bincount(pose, centre != weights.centre, minlength=n_poses) > 0
    # A pose whose centres were just judged anew gets its own verdict in the next round.
    return Weights(centre, np.where(displaced | (out & ~changed & (used > 0)), 0.0, 1.0))
