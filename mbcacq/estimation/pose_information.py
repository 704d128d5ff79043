"""A linearised problem under a noise and weights: block by block of its poses (``PoseBlock``), the sums over all of them, and
the rejection of gross outliers, by weights of 0 or 1 (Huber's weights would keep them with a share).

Outliers are centres that disagree with their pose (a ball taken for another) and poses that disagree with the rest (a bumped tripod, a
wrong pose). Thresholds follow a robust scale, the median, so that rejection works while the geometry is still coarse.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.estimation.pose_block import PoseBlock, WeightedBlock
from mbcacq.estimation.pose_columns import PoseColumns
from mbcacq.estimation.whitening import PoseRows


class WeightedRows:
    """The rows of every pose under weights of the centres and poses, before any noise: what stays when the noise changes.

    weight: (M,) of the centres; counted: that of all rows of an axis.
    """

    def __init__(self, rows: PoseRows, columns: PoseColumns, weight: np.ndarray, pose_weight: np.ndarray):
        """weight: (M,) of the centres, pose_weight: (P,) of the poses, in the order of the observations; 1 full, 0 rejected."""
        self.rows, self.columns, self.weight, self.share = rows, columns, weight, pose_weight[rows.order]
        self.counted = float(np.sum(weight * pose_weight[rows.pose_of_centre]))

    @cached_property
    def blocks(self) -> list[WeightedBlock]:
        """The poses, block by block in the order of ``PoseRows``."""
        rows, columns, share = self.rows, self.columns, self.share
        scale = rows.pad(np.sqrt(self.weight)[:, None] / rows.sigma_scale)
        scale = np.ascontiguousarray(scale.reshape(rows.n_poses, rows.depth, rows.width).transpose(0, 2, 1))
        return [WeightedBlock(of, columns.of_poses(of.poses), scale[of.poses], share[of.poses]) for of in rows.blocks]


class PoseInformation:
    """The columns of every pose under a noise and weights. precision: (R,) of each axis of the rows."""

    def __init__(self, weighted: WeightedRows, columns: PoseColumns, noise: Noise):
        self.weighted, self.columns, self.rows, self.noise = weighted, columns, weighted.rows, noise
        self.precision = 1.0 / noise.row_sigma(self.rows.width) ** 2
        self._products: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @cached_property
    def blocks(self) -> list[PoseBlock]:
        """The same under the noise."""
        noise, columns = self.noise, self.columns
        sigma = np.broadcast_to(self.rows.joint_sigma(noise), (self.rows.n_poses, 1, columns.joints.shape[2]))
        return [PoseBlock(of, columns.of_poses(of.place.poses), noise, sigma[of.place.poses]) for of in self.weighted.blocks]

    def forget(self, weighted: bool = False) -> None:
        """Give back the memory of the blocks, made again where they are asked for. weighted: of all that is made of the columns."""
        vars(self).pop("blocks", None)
        if weighted:
            vars(self.weighted).pop("blocks", None)
            self._products = None

    @classmethod
    def of(cls, rows: PoseRows, columns: PoseColumns, noise: Noise, weight: np.ndarray, pose_weight: np.ndarray) -> PoseInformation:
        """weight: (M,) of the centres, pose_weight: (P,) of the poses, in the order of the observations; 1 full, 0 rejected."""
        return cls(WeightedRows(rows, columns, weight, pose_weight), columns, noise)

    def with_noise(self, noise: Noise) -> PoseInformation:
        """The same rows and weights under another noise."""
        return PoseInformation(self.weighted, self.columns, noise)

    def with_residual(self, columns: PoseColumns) -> PoseInformation:
        """The same columns with another residual."""
        out = copy(self)
        out.columns = columns
        out.blocks = [block.with_residual(columns.of_poses(block.place.poses)) for block in self.blocks]
        return out

    def residual_after(self, step: np.ndarray, station_step: np.ndarray) -> np.ndarray:
        """(P, B R): what a step (g,) of the parameters and twists (S', 6) of the stations leave of the residual."""
        by_pose = station_step[self.rows.run]
        return self.by_pose(lambda of: of.columns.residual - of.columns.change(step, by_pose[of.place.poses]))

    def chi2(self, residual: np.ndarray) -> float:
        """Sum of squares of a residual (P, B R), whitened as this one."""
        return sum(block.chi2(residual[block.place.poses]) for block in self.blocks)

    def products(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products of the columns: H (g, g), and of each station Hss (S', 6, 6), Hsg (S', 6, g). Made once for all residuals."""
        if self._products is None:
            g, count = self.columns.size, len(self.rows.stations)
            H, Hss, Hsg = np.zeros((g, g)), np.zeros((count, 6, 6)), np.zeros((count, 6, g))
            for block in self.blocks:
                part, of_stations, mixed = block.products()
                H += part
                Hss[block.place.stations] += of_stations
                Hsg[block.place.stations] += mixed
            self._products = H, Hss, Hsg
        return self._products

    def right_hand_side(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Products of the residual with the columns, (g,) and those (S', 6) of the stations, and its chi square."""
        b, bs, chi2 = np.zeros(self.columns.size), np.zeros((len(self.rows.stations), 6)), 0.0
        for block in self.blocks:
            part, of_stations, squares = block.right_hand_side()
            b += part
            bs[block.place.stations] += of_stations
            chi2 += squares
        return b, bs, chi2

    def outlier_distances(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared distances in sigma, rejected or not: (M,) of each centre from where its pose, joints shifted to fit, expects it; (P,) of
        each pose from the model, and its degrees of freedom."""
        rows, weight, pose = self.rows, self.weighted.weight, self.rows.pose_of_centre
        # The twist of each pose that its joints' noise explains best moves its rows by so much.
        explained = self.by_pose(lambda of: (of.columns.basis @ (of.joints @ of.residual_joint[..., None]))[..., 0])
        remaining = np.sum((rows.unpad(self.columns.residual - explained) / rows.row_sigma(self.noise)) ** 2, axis=1)
        # r' inv(I + J J') r = |r - J u|^2 + |u|^2 over the centres in use.
        used = np.bincount(pose, remaining * weight, minlength=rows.n_poses)
        by_pose = used + rows.per_pose(self.by_pose(lambda of: np.einsum("pj,pj->p", of.residual_joint, of.residual_joint)))
        return remaining, by_pose, rows.width * np.bincount(pose, weight, minlength=rows.n_poses)

    def by_pose(self, of_block: Callable[[PoseBlock], np.ndarray]) -> np.ndarray:
        """(P, ...) in the order of ``PoseRows``, of the (P, ...) of each block."""
        return np.concatenate([of_block(block) for block in self.blocks])

    @property
    def log_det(self) -> float:
        """Log determinant of the covariance of the rows in use, up to what does not depend on the noise."""
        return sum(block.joint_log_det for block in self.blocks) - float(np.sum(np.log(self.precision))) * self.weighted.counted


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


def reject_outliers(poses: PoseInformation, weights: Weights) -> Weights:
    """New weights, 0 or 1. The worst centre of a pose is judged before its companions, which it spoils."""
    of_centre, of_pose, pose_dof = poses.outlier_distances()
    pose, centre_dof, n_poses = poses.rows.pose_of_centre, np.array(float(poses.rows.width)), len(of_pose)
    count = np.bincount(pose, minlength=n_poses)
    centre = np.ones(len(of_centre))
    displaced = np.zeros(n_poses, bool)
    companions = count[pose] > 1
    if companions.any():
        # The scale is that of all, rejected or not: a median of the survivors would shrink from round to round.
        scale = max(np.median(of_centre[companions]) / chi2_quantile(centre_dof, 0.0), 1e-300)
        worst = np.zeros(n_poses)
        np.maximum.at(worst, pose, of_centre)
        off = companions & (of_centre > max(scale, 0.5) * chi2_quantile(centre_dof, TAIL))
        centre[off & (of_centre > 0.25 * worst[pose])] = 0.0
        # Where most of a pose is off, it is the pose that stands elsewhere.
        displaced = np.bincount(pose, centre == 0, minlength=n_poses) > 0.5 * count
        centre[displaced[pose]] = 1.0
    used = np.bincount(pose, centre, minlength=n_poses)
    judged = pose_dof > 0
    per_dof = of_pose / chi2_quantile(np.maximum(pose_dof, 1.0), 0.0)
    scale = np.median(per_dof[judged]) if judged.any() else 1.0
    out = judged & (of_pose > max(scale, 0.5) * chi2_quantile(np.maximum(pose_dof, 1.0), TAIL))
    changed = np.bincount(pose, centre != weights.centre, minlength=n_poses) > 0
    # A pose whose centres were just judged anew gets its own verdict in the next round.
    return Weights(centre, np.where(displaced | (out & ~changed & (used > 0)), 0.0, 1.0))
