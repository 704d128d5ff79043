"""What the measurements of each pose say of the twist that moves the pose, whitened by scanner noise and joint repeatability.

Every column of the arm, the hand-eye and the stations moves all centres of a pose by one twist, and so does the joint noise. With G the
derivative of a pose's rows by that twist (u columns), scaled by the scanner's sigma, J = G T the columns of the joints times their
repeatability, and S = I + J J' the covariance of the scaled rows, all that a solver asks for follows from a few u x u matrices of each
pose: G' inv(S) G = F' G'G F + (K J'G)' (K J'G), with K = inv(I + J'J) and F = I - T K J'G. Sums of squares only, so that nothing cancels
where the joint noise is far above the scanner's. Own columns (``OwnColumns``: balls, effects) and the residual keep their rows.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.estimation.pose_columns import PoseColumns, WeightedOwnColumns
from mbcacq.estimation.whitening import RowsBlock


class WeightedBlock:
    """The rows of a block of P poses under weights of the centres and poses, axis by axis and before any noise: what stays when the noise
    changes.

    scale: (P, R, B) of the rows. G: (P, R, B, u) scaled derivative by the twist; squares: (P, R, u u) its products, axis by axis. share:
    (P,) weight of the pose.
    """

    def __init__(self, place: RowsBlock, columns: PoseColumns, scale: np.ndarray, share: np.ndarray):
        (P, R, B), u = scale.shape, columns.basis.shape[2]
        self.place, self.scale, self.share = place, scale, share
        self.G = np.empty((P, R, B, u))
        np.multiply(columns.basis.reshape(P, B, R, u).transpose(0, 2, 1, 3), scale[..., None], out=self.G)
        self.squares = (np.swapaxes(self.G, 2, 3) @ self.G).reshape(P, R, u * u)
        self.own = WeightedOwnColumns(columns.own, scale, self.G, share)

    def by_axis(self, residual: np.ndarray) -> np.ndarray:
        """(P, R, B): rows (P, B R), scaled."""
        P, R, B = self.scale.shape
        return residual.reshape(P, B, R).transpose(0, 2, 1) * self.scale


class PoseBlock:
    """The columns of a block of poses under a noise and weights.

    L = G'G (P, u, u) of the rows scaled by the noise, JG = K J'G (P, n, u), F (P, u, u), K (P, n, n). N = T K T' (P, u, u): what the joint
    noise takes off L is L N L. residual_joint = K J' residual (P, n), white_residual = inv(S) residual
    (P, R, B). precision: (R,) of each axis. share: (P,) weight of the pose.
    """

    def __init__(self, weighted: WeightedBlock, columns: PoseColumns, noise: Noise, joint_sigma: np.ndarray):
        """joint_sigma: (P, 1, n) or (1, 1, n) rad."""
        self.weighted, self.columns = weighted, columns
        self.place, self.share, self.own = weighted.place, weighted.share, weighted.own
        (P, R, _), u = weighted.scale.shape, weighted.G.shape[3]
        self.precision = 1.0 / noise.row_sigma(R) ** 2
        self.L = (self.precision @ weighted.squares).reshape(P, u, u)
        self.joints = columns.joints * joint_sigma
        Tt = np.swapaxes(self.joints, 1, 2)
        JL = Tt @ self.L
        gram = JL @ self.joints
        diagonal = np.arange(gram.shape[1])
        gram[:, diagonal, diagonal] += 1.0
        self.K = np.linalg.inv(gram)
        self.JG = self.K @ JL
        self.F = np.eye(u) - self.joints @ self.JG
        self.N = self.joints @ self.K @ Tt
        self._set_residual(columns.residual)

    @cached_property
    def own_twist(self) -> np.ndarray:
        """(P, u, e): G' times the own columns."""
        return self.own.by_twist(self.precision)

    def with_residual(self, columns: PoseColumns) -> PoseBlock:
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
        try:
            root = np.swapaxes(np.linalg.cholesky(inverse), 1, 2)
        except np.linalg.LinAlgError:  # a direction that the joint noise hides: rounding leaves its eigenvalue at zero or below
            values, vectors = np.linalg.eigh(inverse)
            root = np.sqrt(np.maximum(values, 0.0))[..., None] * np.swapaxes(vectors, 1, 2)
        return root @ rows * np.sqrt(self.share)[:, None, None]

    def products(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products of the columns, summed over the poses, and over those of each station at which the block is: H (g, g), Hss (S', 6, 6),
        Hsg (S', 6, g)."""
        A, S, share = self.columns.twists, self.columns.station, self.share[:, None, None]
        f, e = A.shape[2], self.own.columns.size
        H = np.empty((f + e, f + e))
        if self.columns.by_rows:
            W = self.whitened_basis
            station = W @ S
            Hss = self.place.products(station, station)
            H[:f, :f], Hsg = self._products_by_rows(W, station)
        else:
            information = self.twist_information
            right, right_station = information @ A, information @ S
            H[:f, :f] = flat_product(A, right)
            Hss, Hsg = (self.place.products(S, one) for one in (right_station, right))
        if e:
            own = np.swapaxes(self.F, 1, 2) * share @ self.own_twist
            H[:f, f:] = flat_product(A, own)
            H[f:, :f] = H[:f, f:].T
            H[f:, f:] = self.own.gram(self.precision) - flat_product(self.own_twist, self.N @ self.own_twist * share)
            Hsg = np.concatenate([Hsg, self.place.products(S, own)], axis=2)
        return (H + H.T) / 2, Hss, Hsg

    def _products_by_rows(self, W: np.ndarray, station: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products of the twists with each other (f, f) and with the stations (S', 6, f). W: (P, u, u), ``whitened_basis``; station:
        (P, u, 6) whitened columns.
        """
        A, wide, runs = self.columns.twists, self.columns.wide, self.place
        if not wide:
            white = W @ A
            return flat_product(white, white), runs.products(station, white)  # a matrix with itself takes half of the time of another
        f = A.shape[2]
        narrow = np.delete(np.arange(f), np.concatenate([np.arange(one.place.start, one.place.stop) for one in wide]))
        H, Hsg = np.empty((f, f)), np.empty((len(runs.first), 6, f))
        white, units = W @ A[:, :, narrow], W @ np.stack([one.direction for one in wide], axis=2)
        H[np.ix_(narrow, narrow)], Hsg[:, :, narrow] = flat_product(white, white), runs.products(station, white)
        by_narrow, by_station, among = (np.swapaxes(units, 1, 2) @ x for x in (white, station, units))  # (P, number of wide ones, ...)
        for i, one in enumerate(wide):
            H[one.place, narrow] = one.functions.T @ by_narrow[:, i]
            H[narrow, one.place] = H[one.place, narrow].T
            Hsg[:, :, one.place] = runs.products(by_station[:, i, None], one.functions[:, None])
            for j, other in enumerate(wide[: i + 1]):
                H[one.place, other.place] = one.functions.T @ (among[:, i, j, None] * other.functions)
                H[other.place, one.place] = H[one.place, other.place].T
        return H, Hsg

    def right_hand_side(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Products of the residual with the columns, (g,) and those (S', 6) of the stations, and its chi square."""
        columns = self.columns
        rest = np.swapaxes(self.F, 1, 2) @ (self.residual_twist * self.share[:, None])[..., None]
        b = flat_product(columns.twists, rest)[:, 0]
        if self.own.columns.size:
            rows = self.white_residual * (self.share[:, None, None] * np.sqrt(self.precision)[:, None])
            b = np.concatenate([b, self.own.product(rows).sum(axis=1)])
        bs = self.place.products(columns.station, rest)[..., 0]
        return b, bs, self._squares(self.white_residual, self.residual_joint)

    @cached_property
    def joint_log_det(self) -> float:
        """Log determinant of I + J'J, summed over the poses."""
        return float(-np.linalg.slogdet(self.K)[1] @ self.share)


def flat_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(k, m): sum over poses of left' right, left (P, u, k) and right (P, u, m)."""
    rows = left.shape[0] * left.shape[1]
    return left.reshape(rows, left.shape[2]).T @ right.reshape(rows, right.shape[2])
