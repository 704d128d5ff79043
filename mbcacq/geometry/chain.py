"""The serial chain in modified Denavit-Hartenberg form (Hayati / Veitschegger), for all poses at once.

``H_i = Rz(sign_i q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)``, i = 1..n, T_base_flange = H_1 ... H_n.

Small changes are written as spatial twists: (v, w) in the base frame, taken at the base origin, so that a point P that is
carried along moves by ``v + w x P``. This one form serves parameter errors and every physical displacement alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3

PARAMETERS = ("theta", "d", "a", "alpha", "beta")


@dataclass(frozen=True)
class Chain:
    """MD-H rows of an n-axis arm, each (n,): sign (+1/-1), theta rad, d mm, a mm, alpha rad, beta rad."""

    sign: np.ndarray
    theta: np.ndarray
    d: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray

    @property
    def n(self) -> int:
        return len(self.sign)

    @property
    def rows(self) -> np.ndarray:
        """(n, 5) in the order of PARAMETERS."""
        return np.stack([self.theta, self.d, self.a, self.alpha, self.beta], axis=1)

    def with_errors(self, errors: np.ndarray) -> Chain:
        """The chain whose parameters are these plus errors (n, 5)."""
        return type(self)(self.sign, *(self.rows + errors).T)

    @property
    def lever(self) -> np.ndarray:
        """(n,) mm by which a unit of each joint moves a point: half of the reach, on average, is behind a joint."""
        # The height of the first axis' foot is no lever of anything.
        reach = max(float(np.abs(self.a[0]) + np.sum(np.hypot(self.a[1:], self.d[1:]))), 1.0)
        return np.full(self.n, 0.5 * reach)

    def expected_noise(self, repeatability_mm: float) -> np.ndarray:
        """(n,) sigma of each joint by the repeatability of the data sheet: RP = mean + 3 sigma of a distance, about four times the sigma of
        one coordinate."""
        return repeatability_mm / 4 / self.lever

    def drawn_between(self, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) smallest and (n,) largest angle of postures drawn at random within limits (n, 2): no more than one turn."""
        low, high = np.clip(limits, -np.pi, np.pi).T
        return low, high

    def same_links(self, other: Chain) -> bool:
        """Whether another chain has as many axes, which turn the same way, and the same rows but for rounding."""
        return (
            type(self) is type(other) and self.n == other.n and np.allclose(self.rows, other.rows) and bool(np.all(self.sign == other.sign))
        )

    def parallel_next(self, tolerance: float = 1e-6) -> np.ndarray:
        """(n,) bool: axis i+1 is nominally parallel to axis i, so that d_i is redundant and beta_i is needed."""
        direction = np.abs(np.cos(self.alpha) * np.cos(self.beta))
        parallel = direction > 1 - tolerance
        parallel[-1] = False
        return parallel

    def frames(self, q: np.ndarray, displacement: np.ndarray | None = None) -> np.ndarray:
        """T_base_link for all links: (P, n+1, 4, 4); [:, 0] is the base, [:, n] the flange.

        q: (P, n) rad. displacement: (P, n+1, 6) local twists applied behind each frame (0: base, n: flange), or None.
        """
        step = self.link_transforms(q)
        out = np.empty((len(q), self.n + 1, 4, 4), dtype=step.dtype)
        out[:, 0] = np.eye(4) if displacement is None else se3.exp(displacement[:, 0])
        for i in range(self.n):
            out[:, i + 1] = out[:, i] @ step[:, i]
            if displacement is not None:
                out[:, i + 1] = out[:, i + 1] @ se3.exp(displacement[:, i + 1])
        return out

    def flange(self, q: np.ndarray) -> np.ndarray:
        """T_base_flange (P, 4, 4) for q (P, n) rad."""
        return self.frames(q)[:, -1]

    def link_transforms(self, q: np.ndarray) -> np.ndarray:
        """H_i(q_i): (P, n, 4, 4)."""
        angle = self.sign * q + self.theta
        ct, st = np.cos(angle), np.sin(angle)
        ca, sa = np.cos(self.alpha), np.sin(self.alpha)
        cb, sb = np.cos(self.beta), np.sin(self.beta)
        H = np.zeros((*angle.shape, 4, 4), dtype=angle.dtype)
        H[..., 0, 0], H[..., 0, 1], H[..., 0, 2] = ct * cb - st * sa * sb, -st * ca, ct * sb + st * sa * cb
        H[..., 1, 0], H[..., 1, 1], H[..., 1, 2] = st * cb + ct * sa * sb, ct * ca, st * sb - ct * sa * cb
        H[..., 2, 0], H[..., 2, 1], H[..., 2, 2] = -ca * sb, sa, ca * cb
        H[..., 0, 3], H[..., 1, 3], H[..., 2, 3], H[..., 3, 3] = self.a * ct, self.a * st, self.d, 1.0
        return H

    def joint_twists(self, frames: np.ndarray) -> np.ndarray:
        """Spatial twist of a unit of controller angle of each joint: (P, n, 6)."""
        return self.sign[:, None] * rotation_twist(frames[:, :-1, :3, 2], frames[:, :-1, :3, 3])

    def parameter_twists(self, frames: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Spatial twist of a unit error of each MD-H parameter: (P, n, 5, 6), order of PARAMETERS.

        theta and d act about and along z of the frame before the link, a and alpha along and about x of the rotated frame,
        beta about y of the link's own frame. Valid for frames computed without displacement.
        """
        before, after = frames[:, :-1], frames[:, 1:]
        z, origin, tip = before[..., :3, 2], before[..., :3, 3], after[..., :3, 3]
        angle = self.sign * q + self.theta
        x = np.cos(angle)[..., None] * before[..., :3, 0] + np.sin(angle)[..., None] * before[..., :3, 1]
        y = after[..., :3, 1]
        out = np.zeros((*z.shape[:2], 5, 6), dtype=np.result_type(frames, q))
        for k, axis, point in ((0, z, origin), (3, x, tip), (4, y, tip)):
            out[:, :, k, :3], out[:, :, k, 3:] = se3.cross(point, axis), axis
        out[:, :, 1, :3], out[:, :, 2, :3] = z, x
        return out


def rotation_twist(axis: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Spatial twist (..., 6) of a rotation of 1 rad about ``axis`` (..., 3, unit) through ``point`` (..., 3) mm."""
    return np.concatenate([se3.cross(point, axis), axis], -1)
