"""Whitening of each pose by scanner noise and joint repeatability, on rows grouped by pose.

All arrays (P, B R, k): B is the largest number of centres of a pose, poses with fewer have rows of zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.model.observations import Observations

ROWS_AT_ONCE = 12000  # 500 poses with eight balls; fewer cost more calls than they save


class RowsBlock:
    """P consecutive poses, and of the stations in use those that they are at, as runs of these poses. first: (S',) first pose of each."""

    def __init__(self, poses: slice, stations: slice, first: np.ndarray):
        self.poses, self.stations, self.first = poses, stations, first
        self.end = np.append(first[1:], poses.stop - poses.start)
        length = self.end - first
        self.even = bool(np.all(length == length[0]))

    def products(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(S', k, m): sums of left' right over the poses of each station, left (P, u, k) and right (P, u, m)."""
        (P, u, k), m, count = left.shape, right.shape[2], len(self.first)
        a, b = left.reshape(P * u, k), right.reshape(P * u, m)
        if self.even:
            each = P * u // count
            return np.swapaxes(a.reshape(count, each, k), 1, 2) @ b.reshape(count, each, m)
        out = np.empty((count, k, m))
        for s, (start, end) in enumerate(zip(u * self.first, u * self.end, strict=True)):
            np.matmul(a[start:end].T, b[start:end], out=out[s])
        return out

    def times(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(P, u, m): left (P, u, k) of each pose times right (S', k, m) of its station."""
        (P, u, k), m, count = left.shape, right.shape[2], len(self.first)
        a = left.reshape(P * u, k)
        if self.even:
            return (a.reshape(count, P * u // count, k) @ right).reshape(P, u, m)
        out = np.empty((P * u, m))
        for s, (start, end) in enumerate(zip(u * self.first, u * self.end, strict=True)):
            np.matmul(a[start:end], right[s], out=out[start:end])
        return out.reshape(P, u, m)


class PoseRows:
    """Scatter of centres (M, R, ...) into poses (P, B R, ...) and back; stations as runs of consecutive poses.

    blocks: all poses in blocks of about ROWS_AT_ONCE rows, as long as each other where stations allow. What a pass over a block makes stays
    in the caches, and its memory serves the next block; arrays of all poses would come from the main memory at every operation, and the
    system would be asked for them anew.
    """

    def __init__(self, obs: Observations, width: int):
        # Blocks follow the order of stations, so that sums over a station are sums over a run.
        self.order = np.argsort(obs.station, kind="stable")
        place = np.empty(obs.n_poses, int)
        place[self.order] = np.arange(obs.n_poses)
        self.in_order = bool(np.array_equal(self.order, np.arange(obs.n_poses)))
        count = np.bincount(obs.pose, minlength=obs.n_poses)
        rank = np.arange(obs.n_centres) - (np.cumsum(count) - count)[obs.pose]
        self.n_poses, self.depth, self.width = obs.n_poses, int(count.max(initial=1)), width
        self.pose_of_centre = obs.pose
        self.slot = place[obs.pose] * self.depth + rank
        self.full = bool(len(self.slot) == obs.n_poses * self.depth and np.array_equal(self.slot, np.arange(len(self.slot))))
        self.sigma_scale, self.joint_scale = _noise_scales(obs, width)
        station = obs.station[self.order]
        self.first = np.flatnonzero(np.r_[True, np.diff(station) > 0])
        self.stations = station[self.first]
        self.run = np.cumsum(np.r_[0, np.diff(station) > 0])
        self.blocks = self._in_blocks()

    def _in_blocks(self) -> list[RowsBlock]:
        blocks, start = [], 0
        count = round(self.n_poses * self.depth * self.width / ROWS_AT_ONCE)
        each = math.ceil(self.n_poses / max(count, 1))
        while start < self.n_poses:
            end = min(start + each, self.n_poses)
            if end < self.n_poses and self.first[self.run[end]] > start:
                end = int(self.first[self.run[end]])  # whole stations, but of a station that is longer than a block
            stations = slice(self.run[start], self.run[end - 1] + 1)
            blocks.append(RowsBlock(slice(start, end), stations, np.maximum(self.first[stations] - start, 0)))
            start = end
        return blocks

    def row_sigma(self, noise: Noise) -> np.ndarray:
        """(M, R) or (1, R) sigma of the rows of each centre."""
        return noise.row_sigma(self.width) * self.sigma_scale

    def joint_sigma(self, noise: Noise) -> np.ndarray:
        """(P, 1, k) or (1, 1, k) rad repeatability of the n joints and further columns of ``noise.joint``, ordered as the blocks."""
        if len(self.joint_scale) == 1:
            return noise.joint * self.joint_scale
        scale = self.joint_scale[self.order]
        further = np.ones((*scale.shape[:2], len(noise.joint) - scale.shape[2]))
        return noise.joint * np.concatenate([scale, further], axis=2)

    def pad(self, rows: np.ndarray) -> np.ndarray:
        """(M, R, ...) -> (P, B R, ...)."""
        if not self.full:
            out = np.zeros((self.n_poses * self.depth, *rows.shape[1:]), dtype=rows.dtype)
            out[self.slot] = rows
            rows = out
        return rows.reshape(self.n_poses, self.depth * rows.shape[1], *rows.shape[2:])

    def unpad(self, blocks: np.ndarray) -> np.ndarray:
        """(P, B R, ...) -> (M, R, ...)."""
        rows = blocks.reshape(self.n_poses * self.depth, -1, *blocks.shape[2:])
        return rows if self.full else rows[self.slot]

    def per_pose(self, blocks: np.ndarray) -> np.ndarray:
        """Blocks (P, ...) in the order of the observations' poses; where these are so ordered, the blocks themselves."""
        if self.in_order:
            return blocks
        out = np.empty_like(blocks)
        out[self.order] = blocks
        return out


def _noise_scales(obs: Observations, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Relative sigma of the rows (M, R) and of the joints (P, 1, n); (1, R) and (1, 1, n) of ones where there is one recording."""
    if obs.noise_scale is None:
        return np.ones((1, width)), np.ones((1, 1, 1))
    point = obs.noise_scale[obs.pose, :3]
    return np.concatenate([point, np.ones((len(point), width - 3))], axis=1), obs.noise_scale[:, None, 3:]


COLUMNS_AT_ONCE = 128  # of a whitening: several copies of them are in memory


class Whitening:
    """W with W' W = inverse covariance of every pose, as one small matrix per pose.

    With rows scaled by the scanner's sigma, J the scaled columns of the joints times their repeatability and L L' = I + J'J:
    W = I - J M J', M = inv(L L' + L), for which W'W = I - J inv(I + J'J) J' = inv(I + J J').
    """

    def __init__(self, rows: PoseRows, joint: np.ndarray, noise: Noise, weight: np.ndarray, pose_weight: np.ndarray):
        """joint: (P, B R, n) derivative by the joints; weight: (M,) of the centres, pose_weight: (P,) of the poses, in the order of
        the observations, 0 = rejected, 1 = full (a share w counts as a variance 1 / w times as large)."""
        scale = np.sqrt(weight)[:, None] / rows.row_sigma(noise)
        self.scale = rows.pad(scale)[..., None]
        self.pose_scale = np.sqrt(pose_weight[rows.order])[:, None, None]
        self.J = joint * self.scale * rows.joint_sigma(noise)
        self.scale = self.scale * self.pose_scale
        gram = np.swapaxes(self.J, 1, 2) @ self.J
        gram[:, np.arange(gram.shape[1]), np.arange(gram.shape[1])] += 1.0
        L = np.linalg.cholesky(gram)
        self.log_det = 2 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum()
        self.M = np.linalg.inv(gram + L)
        # With few rows W itself is smaller than what it is made of.
        few = self.J.shape[1] <= self.J.shape[2]
        self.W = (np.eye(self.J.shape[1]) - self.J @ self.M @ np.swapaxes(self.J, 1, 2)) * np.swapaxes(self.scale, 1, 2) if few else None

    def __call__(self, blocks: np.ndarray) -> np.ndarray:
        """W X for blocks (P, B R, k)."""
        if self.W is not None:
            return self.W @ blocks
        X = blocks * self.scale
        X -= self.J @ (self.M @ (np.swapaxes(self.J, 1, 2) @ X))
        return X

    def transpose(self, blocks: np.ndarray) -> np.ndarray:
        """W' X for blocks (P, B R, k)."""
        X = blocks - self.J @ (np.swapaxes(self.M, 1, 2) @ (np.swapaxes(self.J, 1, 2) @ blocks))
        X *= self.scale
        return X


class CentreWhitening:
    """The same whitening of rows that are given centre by centre: (M, R) or (M, R, k) become (M R,) or (M R, k) of unit variance.

    Centres that are not kept have rows of zero. log_det: log determinant of the covariance of the rows kept.
    """

    def __init__(self, rows: PoseRows, joint: np.ndarray, noise: Noise, keep: np.ndarray):
        """joint: (P, B R, n) derivative by the joints; keep: (M,) bool."""
        self.rows, self.noise = rows, noise
        self.blocks = Whitening(rows, joint, noise, keep.astype(float), np.ones(rows.n_poses))
        self.log_det = float(self.blocks.log_det + 2 * np.sum(keep[:, None] * np.log(rows.row_sigma(noise))))

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        flat = columns if columns.ndim == 3 else columns[..., None]
        M, R, k = flat.shape
        if k <= COLUMNS_AT_ONCE:
            out = self.rows.unpad(self.blocks(self.rows.pad(flat))).reshape(M * R, k)
        else:
            out = np.empty((M * R, k))
            for first in range(0, k, COLUMNS_AT_ONCE):
                some = slice(first, first + COLUMNS_AT_ONCE)
                out[:, some] = self.rows.unpad(self.blocks(self.rows.pad(flat[:, :, some]))).reshape(M * R, -1)
        return out if columns.ndim == 3 else out[:, 0]

    def transpose(self, rows: np.ndarray) -> np.ndarray:
        """W' applied to whitened rows (M R,) or (M R, k) -> (M, R) or (M, R, k)."""
        flat = rows.reshape(-1, self.rows.width, 1 if rows.ndim == 1 else rows.shape[1])
        out = self.rows.unpad(self.blocks.transpose(self.rows.pad(flat)))
        return out[..., 0] if rows.ndim == 1 else out

    def pose_products(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(P, c, z): left'right over the rows of each pose; left (M R, c), right (M R, z), whitened or not."""
        a, b = (self.rows.pad(x.reshape(-1, self.rows.width, x.shape[1])) for x in (left, right))
        return self.rows.per_pose(np.swapaxes(a, 1, 2) @ b)

    def gram(self, unit: np.ndarray, functions: np.ndarray, together: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Products of the whitened columns unit (M, R, c) times functions (M, f). together: of each result (n, c, c, k, k) the functions
        (n, k) of which every two are multiplied, for every two components.

        With W'W = s (I - J inv(I + J'J) J') s, s the scale of the rows, no whitened column is made.
        """
        rows, blocks, (c, f) = self.rows, self.blocks, (unit.shape[2], functions.shape[1])
        scaled = rows.pad(unit) * blocks.scale
        F = rows.pad(functions[:, None, :])
        by_centre = scaled.reshape(rows.n_poses, rows.depth, rows.width, c)
        J = blocks.J.reshape(rows.n_poses, rows.depth, rows.width, -1)
        own = np.einsum("pbrc,pbrd->cdpb", by_centre, by_centre).reshape(c, c, -1)
        mixed = (np.swapaxes(J, 2, 3) @ by_centre).reshape(rows.n_poses, rows.depth, -1)
        T = (np.swapaxes(mixed, 1, 2) @ F).reshape(rows.n_poses, -1, c * f)
        L = np.linalg.cholesky(np.swapaxes(blocks.J, 1, 2) @ blocks.J + np.eye(J.shape[3]))
        T = (np.linalg.inv(L) @ T).reshape(-1, c, f)  # a product of small matrices is cheaper than as many solutions
        by_function, eliminated, out = np.ascontiguousarray(F.reshape(-1, f).T), np.ascontiguousarray(T.transpose(2, 1, 0)), []
        for index in together:
            n, k = index.shape
            here, taken = by_function[index], eliminated[index].transpose(0, 2, 1, 3).reshape(n, c * k, -1)
            products = -(taken @ np.swapaxes(taken, 1, 2)).reshape(n, c, k, c, k).transpose(0, 1, 3, 2, 4)
            for i in range(c):
                for j in range(i + 1):
                    if own[i, j].any():
                        product = here @ np.swapaxes(own[i, j] * here, 1, 2)
                        products[:, i, j] += product
                        if i != j:
                            products[:, j, i] += product
            out.append(products)
        return out
