"""What the measurements of each pose say of the twist that moves the pose, whitened by scanner noise and joint repeatability.

Every column of the arm, the hand-eye and the stations moves all centres of a pose by one twist, and so does the joint noise. With G the
derivative of a pose's rows by that twist (u columns), scaled by the scanner's sigma, J = G T the columns of the joints times their
repeatability, and S = I + J J' the covariance of the scaled rows, all that a solver asks for follows from a few u x u matrices of each
pose: G' inv(S) G = F' G'G F + (K J'G)' (K J'G), with K = inv(I + J'J) and F = I - T K J'G. Sums of squares only, so that nothing cancels
where the joint noise is far above the scanner's. Own columns (balls, effects) and the residual keep their rows.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.estimation.whitening import PoseRows


@dataclass(frozen=True)
class PoseColumns:
    """A linearised problem, pose by pose in the order of ``PoseRows``.

    basis: (P, B R, u) derivative of a pose's rows by its twist. twists: (P, u, f + 6) of the first f parameters and of the pose's own
    station; joints: (P, u, n) of the joints. own: (P, B R, e) columns of the other parameters. residual: (P, B R).
    """

    basis: np.ndarray
    twists: np.ndarray
    joints: np.ndarray
    own: np.ndarray
    residual: np.ndarray

    @property
    def size(self) -> int:
        """Number of parameters g = f + e."""
        return self.twists.shape[2] - 6 + self.own.shape[2]

    @property
    def dense(self) -> np.ndarray:
        """(P, B R, g + 7) columns of the parameters, of the pose's own station (6), and the residual (1)."""
        f = self.twists.shape[2] - 6
        moved = self.basis @ self.twists
        return np.concatenate([moved[..., :f], self.own, moved[..., f:], self.residual[..., None]], axis=2)

    def change(self, step: np.ndarray, station_step: np.ndarray) -> np.ndarray:
        """(P, B R): what a step (g,) of the parameters and twists (P, 6) of the poses' stations take off the residual."""
        f = self.twists.shape[2] - 6
        twist = self.twists[..., :f] @ step[:f] + (self.twists[..., f:] @ station_step[..., None])[..., 0]
        return (self.basis @ twist[..., None])[..., 0] + self.own @ step[f:]


class PoseInformation:
    """The columns of every pose under a noise and weights.

    G (P, B R, u), own (P, B R, e), residual (P, B R): scaled rows. L = G'G (P, u, u), JG = K J'G (P, n, u), F (P, u, u), K (P, n, n).
    own_joint = K J' own (P, n, e) and white_own (P, B R, e) = inv(S) own; the same of the residual. share: (P,) weight of the pose.
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
        self.K = np.linalg.inv(gram)
        self.JG = self.K @ JL
        self.F = np.eye(self.L.shape[1]) - self.joints @ self.JG
        self.own = columns.own * self.scale[..., None]
        self.own_twist = Gt @ self.own
        self.own_joint = self._by_joints(self.own_twist)
        self.white_own = self.own - self.G @ (self.joints @ self.own_joint) if self.own.shape[2] else self.own
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
        rows, A, share = self.rows, self.columns.twists, self.share[:, None, None]
        f, e = A.shape[2] - 6, self.own.shape[2]
        Ft = np.swapaxes(self.F, 1, 2)
        moved = self.twist_information @ A  # (P, u, f + 6)
        other = np.concatenate([Ft @ self.own_twist, Ft @ self.residual_twist[..., None]], axis=2) * share  # (P, u, e + 1)
        flat = A[..., :f].reshape(len(A) * A.shape[1], f)
        H, b = np.empty((f + e, f + e)), np.empty(f + e)
        H[:f, :f] = flat.T @ moved[..., :f].reshape(len(flat), f)
        cross = flat.T @ other.reshape(-1, e + 1)
        H[:f, f:], b[:f] = cross[:, :e], cross[:, e]
        H[f:, :f] = cross[:, :e].T
        if e:
            root = np.sqrt(share)
            white, joint = ((x * root).reshape(-1, e) for x in (self.white_own, self.own_joint))
            H[f:, f:] = white.T @ white + joint.T @ joint
            b[f:] = (self.own * share).reshape(-1, e).T @ self.white_residual.reshape(-1)
        St = np.swapaxes(A[..., f:], 1, 2)
        station = rows.by_station(St @ np.concatenate([moved[..., :f], other, moved[..., f:]], axis=2))
        Hsg, bs, Hss = station[..., : f + e], station[..., f + e], station[..., f + e + 1 :]
        H = (H + H.T) / 2
        return NormalBlocks(H, b, self._squares(self.white_residual, self.residual_joint), Hss, Hsg, bs)


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
