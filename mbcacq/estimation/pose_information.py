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
from mbcacq.estimation.own_columns import OwnColumns
from mbcacq.estimation.whitening import PoseRows


@dataclass(frozen=True)
class PoseColumns:
    """A linearised problem, pose by pose in the order of ``PoseRows``.

    basis: (P, B R, u) derivative of a pose's rows by its twist. twists: (P, u, f) of the first f parameters; station: (P, u, 6) of the
    pose's own station; joints: (P, u, n) of the joints. own: the e columns of the other parameters. residual: (P, B R).
    """

    basis: np.ndarray
    twists: np.ndarray
    station: np.ndarray
    joints: np.ndarray
    own: OwnColumns
    residual: np.ndarray

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


class PoseInformation:
    """The columns of every pose under a noise and weights.

    G (P, B R, u), own (e columns), residual (P, B R): scaled rows. L = G'G (P, u, u), JG = K J'G (P, n, u), F (P, u, u), K (P, n, n).
    N = T K T' (P, u, u): what the joint noise takes off L is L N L. own_twist = G' own (P, u, e). residual_joint = K J' residual (P, n),
    white_residual = inv(S) residual (P, B R). share: (P,) weight of the pose.
    """

    def __init__(self, rows: PoseRows, columns: PoseColumns, noise: Noise, weight: np.ndarray, pose_weight: np.ndarray):
        """weight: (M,) of the centres, pose_weight: (P,) of the poses, in the order of the observations; see ``Whitening``."""
        self.rows, self.columns = rows, columns
        self.scale = rows.pad(np.sqrt(weight)[:, None] / rows.row_sigma(noise))
        self.centre_weight = rows.pad(np.broadcast_to(weight[:, None], (len(weight), rows.width)))
        self.share = pose_weight[rows.order]
        self.G = columns.basis * self.scale[..., None]
        Gt = np.swapaxes(self.G, 1, 2)
        self.L = Gt @ self.G
        self.joints = columns.joints * rows.joint_sigma(noise)
        JL = np.swapaxes(self.joints, 1, 2) @ self.L
        gram = JL @ self.joints
        diagonal = np.arange(gram.shape[1])
        gram[:, diagonal, diagonal] += 1.0
        self.gram = gram
        self.K = np.linalg.inv(gram)
        self.JG = self.K @ JL
        self.F = np.eye(self.L.shape[1]) - self.joints @ self.JG
        self.N = self.joints @ self.K @ np.swapaxes(self.joints, 1, 2)
        self.own = columns.own.scaled(self.scale)
        self.own_twist = self.own.by_twist(self.G)
        self._set_residual(columns.residual)

    def _by_joints(self, twist: np.ndarray) -> np.ndarray:
        return self.K @ (np.swapaxes(self.joints, 1, 2) @ twist)

    def _set_residual(self, residual: np.ndarray) -> None:
        self.residual = residual * self.scale
        self.residual_twist, self.residual_joint, self.white_residual = self._whitened(self.residual)

    def _whitened(self, scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P, u) G'r, (P, n) K J'r and (P, B R) inv(S) r of scaled rows r (P, B R)."""
        twist = np.swapaxes(self.G, 1, 2) @ scaled[..., None]
        joint = self._by_joints(twist)
        return twist[..., 0], joint[..., 0], scaled - (self.G @ (self.joints @ joint))[..., 0]

    def with_residual(self, columns: PoseColumns) -> PoseInformation:
        """The same columns with another residual."""
        out = copy(self)
        out.columns = columns
        out._set_residual(columns.residual)
        return out

    @property
    def log_det(self) -> float:
        """Log determinant of the covariance of the scaled rows."""
        return float(np.linalg.slogdet(self.gram)[1].sum())

    def chi2(self, residual: np.ndarray) -> float:
        """Sum of squares of a residual (P, B R), whitened as this one."""
        _, joint, white = self._whitened(residual * self.scale)
        return self._squares(white, joint)

    def _squares(self, white: np.ndarray, joint: np.ndarray) -> float:
        return float(self.share @ (np.einsum("pi,pi->p", white, white) + np.einsum("pi,pi->p", joint, joint)))

    @property
    def twist_information(self) -> np.ndarray:
        """(P, u, u): G' inv(S) G."""
        Ft, JGt = np.swapaxes(self.F, 1, 2), np.swapaxes(self.JG, 1, 2)
        return (Ft @ self.L @ self.F + JGt @ self.JG) * self.share[:, None, None]

    def normal_equations(self) -> NormalBlocks:
        """Sums over all poses and over those of each station."""
        A, S, share = self.columns.twists, self.columns.station, self.share[:, None, None]
        f, e = A.shape[2], self.own.size
        information, Ft = self.twist_information, np.swapaxes(self.F, 1, 2) * share
        moved, own, rest = information @ A, Ft @ self.own_twist, Ft @ self.residual_twist[..., None]
        H, b = np.empty((f + e, f + e)), np.empty(f + e)
        H[:f, :f], b[:f] = flat_product(A, moved), flat_product(A, rest)[:, 0]
        H[:f, f:] = flat_product(A, own)
        H[f:, :f] = H[:f, f:].T
        if e:
            H[f:, f:] = self.own.gram(self.share) - flat_product(self.own_twist, self.N @ self.own_twist * share)
            b[f:] = self.own.product(self.white_residual[..., None] * share)[:, 0]
        St, by_station = np.swapaxes(S, 1, 2), self.rows.by_station
        Hsg = np.concatenate([by_station(St @ moved), by_station(St @ own)], axis=2)
        chi2 = self._squares(self.white_residual, self.residual_joint)
        return NormalBlocks((H + H.T) / 2, b, chi2, by_station(St @ (information @ S)), Hsg, by_station(St @ rest)[..., 0])


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
