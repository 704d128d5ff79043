"""What the measurements of each pose say of the twist that moves the pose, whitened by scanner noise and joint repeatability.

Every column of the arm, the hand-eye and the stations moves all centres of a pose by one twist, and so does the joint noise. With G the
derivative of a pose's rows by that twist (u columns), scaled by the scanner's sigma, J = G T the columns of the joints times their
repeatability, and S = I + J J' the covariance of the scaled rows, all that a solver asks for follows from a few u x u matrices of each
pose: G' inv(S) G = F' G'G F + (K J'G)' (K J'G), with K = inv(I + J'J) and F = I - T K J'G. Sums of squares only, so that nothing cancels
where the joint noise is far above the scanner's. Own columns (``OwnColumns``: balls, effects) and the residual keep their rows.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.estimation.own_columns import OwnColumns, WeightedOwnColumns
from mbcacq.estimation.whitening import PoseRows


@dataclass(frozen=True)
class PoseColumns:
    """A linearised problem, pose by pose in the order of ``PoseRows``.

    basis: (P, B R, u) derivative of a pose's rows by its twist. twists: (P, u, f) of the first f parameters; station: (P, u, 6) of the
    pose's own station; joints: (P, u, n) of the joints. own: the e columns of the other parameters. residual: (P, B R). by_rows: whether
    the first columns of the basis are the rows themselves, so that any column is a twist.
    """

    basis: np.ndarray
    twists: np.ndarray
    station: np.ndarray
    joints: np.ndarray
    own: OwnColumns
    residual: np.ndarray
    by_rows: bool = False

    @property
    def size(self) -> int:
        """Number of parameters g = f + e."""
        return self.twists.shape[2] + self.own.size

    @property
    def of_parameters(self) -> np.ndarray:
        """(P, B R, g)."""
        return np.concatenate([self.basis @ self.twists, self.own.dense], axis=2)

    @property
    def of_station(self) -> np.ndarray:
        """(P, B R, 6) of the pose's own station."""
        return self.basis @ self.station

    @property
    def of_joints(self) -> np.ndarray:
        """(P, B R, n)."""
        return self.basis @ self.joints

    @property
    def dense(self) -> np.ndarray:
        """(P, B R, g + 7) columns of the parameters, of the pose's own station (6), and the residual (1)."""
        return np.concatenate([self.of_parameters, self.of_station, self.residual[..., None]], axis=2)

    def with_parameters(self, columns: np.ndarray) -> PoseColumns:
        """The same with further parameters, of which these are the columns (P, B R, k)."""
        if self.by_rows and not self.own.size:
            further = self.basis.shape[2] - columns.shape[1]
            return replace(self, twists=np.concatenate([self.twists, np.pad(columns, [(0, 0), (0, further), (0, 0)])], axis=2))
        return replace(self, own=replace(self.own, other=np.concatenate([self.own.other, columns], axis=2)))

    def with_noise(self, columns: np.ndarray) -> PoseColumns:
        """The same with further noise of each pose: columns (P, B R, k) are taken as those of the joints are."""
        k = columns.shape[2]
        added = [(0, 0), (0, k), (0, 0)]
        own = np.broadcast_to(np.eye(self.basis.shape[2] + k)[:, -k:], (len(columns), self.basis.shape[2] + k, k))
        return replace(
            self,
            basis=np.concatenate([self.basis, columns], axis=2),
            twists=np.pad(self.twists, added),
            station=np.pad(self.station, added),
            joints=np.concatenate([np.pad(self.joints, added), own], axis=2),
        )

    def change(self, step: np.ndarray, station_step: np.ndarray) -> np.ndarray:
        """(P, B R): what a step (g,) of the parameters and twists (P, 6) of the poses' stations take off the residual."""
        f = self.twists.shape[2]
        twist = self.twists @ step[:f] + (self.station @ station_step[..., None])[..., 0]
        return (self.basis @ twist[..., None])[..., 0] + self.own.change(step[f:])


class WeightedRows:
    """The rows of every pose under weights of the centres and poses, axis by axis and before any noise: what stays when the noise changes.

    scale: (P, R, B) of the rows. G: (P, R, B, u) scaled derivative by the twist; squares: (P, R, u u) its products, axis by axis. share:
    (P,) weight of the pose. counted: (R,) weight of all rows of an axis.
    """

    def __init__(self, rows: PoseRows, columns: PoseColumns, weight: np.ndarray, pose_weight: np.ndarray):
        """weight: (M,) of the centres, pose_weight: (P,) of the poses, in the order of the observations; 1 full, 0 rejected."""
        P, R, B, u = rows.n_poses, rows.width, rows.depth, columns.basis.shape[2]
        self.rows, self.share = rows, pose_weight[rows.order]
        scale = rows.pad(np.sqrt(weight)[:, None] / rows.sigma_scale)
        self.scale = np.ascontiguousarray(scale.reshape(P, B, R).transpose(0, 2, 1))
        self.G = np.empty((P, R, B, u))
        np.multiply(columns.basis.reshape(P, B, R, u).transpose(0, 2, 1, 3), self.scale[..., None], out=self.G)
        self.squares = (np.swapaxes(self.G, 2, 3) @ self.G).reshape(P, R, u * u)
        self.counted = np.full(R, float(np.sum(weight * pose_weight[rows.pose_of_centre])))
        self.own = WeightedOwnColumns(columns.own, self.scale, self.G, self.share)

    def by_axis(self, residual: np.ndarray) -> np.ndarray:
        """(P, R, B): rows (P, B R), scaled."""
        P, R, B = self.scale.shape
        return residual.reshape(P, B, R).transpose(0, 2, 1) * self.scale


class PoseInformation:
    """The columns of every pose under a noise and weights.

    L = G'G (P, u, u) of the rows scaled by the noise, JG = K J'G (P, n, u), F (P, u, u), K (P, n, n). N = T K T' (P, u, u): what the joint
    noise takes off L is L N L. own_twist = G' own (P, u, e). residual_joint = K J' residual (P, n), white_residual = inv(S) residual
    (P, R, B). precision: (R,) of each axis. share: (P,) weight of the pose.
    """

    def __init__(self, weighted: WeightedRows, columns: PoseColumns, noise: Noise):
        self.weighted, self.columns, self.noise = weighted, columns, noise
        self.rows, self.share, self.own = weighted.rows, weighted.share, weighted.own
        P, u = len(self.share), weighted.G.shape[3]
        self.precision = 1.0 / noise.row_sigma(self.rows.width) ** 2
        self.L = (self.precision @ weighted.squares).reshape(P, u, u)
        self.joints = columns.joints * self.rows.joint_sigma(noise)
        Tt = np.swapaxes(self.joints, 1, 2)
        JL = Tt @ self.L
        gram = JL @ self.joints
        diagonal = np.arange(gram.shape[1])
        gram[:, diagonal, diagonal] += 1.0
        self.K = np.linalg.inv(gram)
        self.JG = self.K @ JL
        self.F = np.eye(u) - self.joints @ self.JG
        self.N = self.joints @ self.K @ Tt
        self.own_twist = self.own.by_twist(self.precision)
        self._set_residual(columns.residual)

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
        out._set_residual(columns.residual)
        return out

    def _set_residual(self, residual: np.ndarray) -> None:
        self.residual_twist, self.residual_joint, self.white_residual = self._whitened(residual)

    def _whitened(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P, u) G'r, (P, n) K J'r and (P, R, B) inv(S) r of the scaled rows r of a residual (P, B R)."""
        G, rows = self.weighted.G, self.weighted.by_axis(residual)
        P, R, B, u = G.shape
        flat = G.reshape(P, R * B, u)
        twist = np.swapaxes(flat, 1, 2) @ (rows * self.precision[:, None]).reshape(P, R * B, 1)
        joint = self.K @ (np.swapaxes(self.joints, 1, 2) @ twist)
        white = rows - (flat @ (self.joints @ joint)).reshape(P, R, B)
        white *= np.sqrt(self.precision)[:, None]
        return twist[..., 0], joint[..., 0], white

    def chi2(self, residual: np.ndarray) -> float:
        """Sum of squares of a residual (P, B R), whitened as this one."""
        _, joint, white = self._whitened(residual)
        return self._squares(white, joint)

    def _squares(self, white: np.ndarray, joint: np.ndarray) -> float:
        return float(self.share @ (np.einsum("prb,prb->p", white, white) + np.einsum("pi,pi->p", joint, joint)))

    @property
    def twist_information(self) -> np.ndarray:
        """(P, u, u): G' inv(S) G."""
        Ft, JGt = np.swapaxes(self.F, 1, 2), np.swapaxes(self.JG, 1, 2)
        return (Ft @ self.L @ self.F + JGt @ self.JG) * self.share[:, None, None]

    @property
    def whitened_basis(self) -> np.ndarray:
        """(P, B R, u): W with W'W = G' inv(S) G, weights of the poses included."""
        G = self.weighted.G
        P, R, B, u = G.shape
        rows = (G * np.sqrt(self.precision)[:, None, None]).reshape(P, R * B, u)
        inverse = np.eye(R * B) - rows @ self.N @ np.swapaxes(rows, 1, 2)
        return np.swapaxes(np.linalg.cholesky(inverse), 1, 2) @ rows * np.sqrt(self.share)[:, None, None]

    def normal_equations(self) -> NormalBlocks:
        """Sums over all poses and over those of each station."""
        A, S, share = self.columns.twists, self.columns.station, self.share[:, None, None]
        f, e = A.shape[2], self.own.columns.size
        if self.columns.by_rows:  # the product of a matrix with itself takes half of the time of another
            W = self.whitened_basis
            left = right = W @ A
            left_station = right_station = W @ S
        else:
            information = self.twist_information
            left, right, left_station, right_station = A, information @ A, S, information @ S
        H = np.empty((f + e, f + e))
        H[:f, :f] = flat_product(left, right)
        Hss, Hsg = (self.rows.station_products(left_station, one) for one in (right_station, right))
        if e:
            own = np.swapaxes(self.F, 1, 2) * share @ self.own_twist
            H[:f, f:] = flat_product(A, own)
            H[f:, :f] = H[:f, f:].T
            H[f:, f:] = self.own.gram(self.precision) - flat_product(self.own_twist, self.N @ self.own_twist * share)
            Hsg = np.concatenate([Hsg, self.rows.station_products(S, own)], axis=2)
        b, bs, chi2 = self.right_hand_side()
        return NormalBlocks((H + H.T) / 2, b, chi2, Hss, Hsg, bs)

    def right_hand_side(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Products of the residual with the columns, (g,) and those (S', 6) of the stations, and its chi square."""
        columns = self.columns
        rest = np.swapaxes(self.F, 1, 2) @ (self.residual_twist * self.share[:, None])[..., None]
        b = flat_product(columns.twists, rest)[:, 0]
        if self.own.columns.size:
            rows = self.white_residual * (self.share[:, None, None] * np.sqrt(self.precision)[:, None])
            b = np.concatenate([b, self.own.product(rows).sum(axis=1)])
        bs = self.rows.station_products(columns.station, rest)[..., 0]
        return b, bs, self._squares(self.white_residual, self.residual_joint)

    @property
    def log_det(self) -> float:
        """Log determinant of the covariance of the rows in use, up to what does not depend on the noise."""
        of_joints = -np.linalg.slogdet(self.K)[1] @ self.share
        return float(of_joints - np.log(self.precision) @ self.weighted.counted)


def flat_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(k, m): sum over poses of left' right, left (P, u, k) and right (P, u, m)."""
    rows = left.shape[0] * left.shape[1]
    return left.reshape(rows, left.shape[2]).T @ right.reshape(rows, right.shape[2])


@dataclass(frozen=True)
class NormalBlocks:
    """Normal equations of g parameters and 6 of each station. H (g, g), b (g,), chi2 of the residual; Hss (S', 6, 6), Hsg (S', 6, g),
    bs (S', 6)."""

    H: np.ndarray
    b: np.ndarray
    chi2: float
    Hss: np.ndarray
    Hsg: np.ndarray
    bs: np.ndarray
