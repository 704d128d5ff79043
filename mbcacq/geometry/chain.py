"""The serial chain in modified Denavit-Hartenberg form (Hayati / Veitschegger), for all poses at once.

``H_i = Rz(sign_i q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)`` of a revolute joint and
``H_i = Rz(theta_i) Tz(sign_i q_i + d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)`` of a prismatic one, i = 1..n, T_base_flange = H_1 ... H_n.

A track, a lift or a gantry is the first rows of the arm. A turntable or a positioner that carries the artefact is first rows, too: seen
from its table, its axes move the floor, and the floor carries the arm. The base is then the table, and the stations stand on it.

Small changes are written as spatial twists: (v, w) in the base frame, taken at the base origin, so that a point P that is
carried along moves by ``v + w x P``. This one form serves parameter errors and every physical displacement alike.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from mbcacq.geometry import se3

PARAMETERS = ("theta", "d", "a", "alpha", "beta")


@dataclass(frozen=True)
class Chain:
    """MD-H rows of n joints, each (n,): sign (+1/-1), theta rad, d mm, a mm, alpha rad, beta rad.

    sliding: indices of the prismatic joints, whose q is in mm. floor: how many of the first joints carry the artefact, which is the index
    of the frame that stands on the floor. root: (4, 4) frame of the first joint in the base, None: they are one. follows: (joint, leader,
    ratio) of each joint that a belt or a parallelogram moves with another one: its position is its own, which is zero but for errors, plus
    so many times the leader's.
    """

    sign: np.ndarray
    theta: np.ndarray
    d: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    _: KW_ONLY
    sliding: tuple[int, ...] = ()
    floor: int = 0
    root: np.ndarray | None = None
    follows: tuple[tuple[int, int, float], ...] = ()

    @property
    def n(self) -> int:
        return len(self.sign)

    @property
    def rows(self) -> np.ndarray:
        """(n, 5) in the order of PARAMETERS."""
        return np.stack([self.theta, self.d, self.a, self.alpha, self.beta], axis=1)

    def with_errors(self, errors: np.ndarray) -> Chain:
        """The chain whose parameters are these plus errors (n, 5)."""
        return self.with_rows(self.rows + errors)

    def with_rows(self, rows: np.ndarray) -> Chain:
        """The same joints with other rows (n, 5)."""
        return replace(self, **dict(zip(PARAMETERS, rows.T, strict=True)))

    @property
    def prismatic(self) -> np.ndarray:
        """(n,) bool: the joint slides."""
        return np.isin(np.arange(self.n), self.sliding)

    @property
    def coupling(self) -> np.ndarray:
        """(n, n): position of each joint by the positions that are counted."""
        out = np.eye(self.n)
        for joint, leader, ratio in self.follows:
            out[joint, leader] = ratio
        return out

    def of_leaders(self, of_joints: np.ndarray) -> np.ndarray:
        """What a unit of each position that is counted moves (.., n, k), from what each joint by itself moves; also of torques."""
        return self.coupling.T @ of_joints if self.follows else of_joints

    def by_kind(self, angle: float, length: float) -> np.ndarray:
        """(n,): one number for each revolute joint, another for each prismatic one."""
        return np.where(self.prismatic, length, angle)

    @property
    def first_turning(self) -> int:
        """Index of the first joint that turns the arm: behind a track, a lift, and what carries the artefact."""
        return next((i for i in range(self.floor, self.n) if i not in self.sliding), self.floor)

    @property
    def reach(self) -> float:
        """mm from the first axis that turns the arm to the flange, all links stretched."""
        first = self.first_turning
        # The height of the first axis' foot is no lever of anything.
        return max(float(np.abs(self.a[first]) + np.sum(np.hypot(self.a[first + 1 :], self.d[first + 1 :]))), 1.0)

    @property
    def lever(self) -> np.ndarray:
        """(n,) mm by which a unit of each joint moves a point: half of the reach, on average, is behind a revolute joint."""
        return self.by_kind(0.5 * self.reach, 1.0)

    def expected_noise(self, repeatability_mm: float) -> np.ndarray:
        """(n,) sigma of each joint by the repeatability of the data sheet: RP = mean + 3 sigma of a distance, about four times the sigma of
        one coordinate."""
        return repeatability_mm / 4 / self.lever

    def drawn_between(self, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) smallest and (n,) largest position of postures drawn at random within limits (n, 2): no more than one turn."""
        low, high = np.where(self.prismatic[:, None], limits, np.clip(limits, -np.pi, np.pi)).T
        return low, high

    def same_links(self, other: Chain) -> bool:
        """Whether another chain has as many axes of the same kinds, which turn the same way, and the same rows but for rounding."""
        alike = type(self) is type(other) and self.n == other.n and (self.sliding, self.floor) == (other.sliding, other.floor)
        return alike and all(np.allclose(*pair) for pair in zip(self._numbers, other._numbers, strict=True))

    @property
    def _numbers(self) -> tuple[np.ndarray, ...]:
        return self.rows, self.sign, self.coupling, self._first

    @property
    def _first(self) -> np.ndarray:
        return np.eye(4) if self.root is None else self.root

    def parallel_next(self, tolerance: float = 1e-6) -> np.ndarray:
        """(n,) bool: axis i+1 is nominally parallel to axis i, so that d_i is redundant and beta_i is needed."""
        direction = np.abs(np.cos(self.alpha) * np.cos(self.beta))
        parallel = direction > 1 - tolerance
        parallel[-1] = False
        return parallel

    def redundant(self, base_known: bool = False, tolerance: float = 1e-6) -> np.ndarray:
        """(n, 5) bool: a parameter that acts like others of the chain, or like displacements of the flange, and of the base where that is
        not known.

        A chain has 4 independent parameters for each revolute joint and 2 for each prismatic one, less 6 for an unknown base. They are
        found by orthogonalising the twists of the flange at random postures, the last rows and the common parameters first.
        """
        low, high = self.drawn_between(np.where(self.prismatic[:, None], [-1e3, 1e3], [-np.pi, np.pi]))
        q = np.random.default_rng(0).uniform(low, high, (12 * self.n, self.n))
        frames = self.frames(q)
        rigid = np.broadcast_to(np.eye(6), (len(q), 6, 6))
        known = [np.swapaxes(se3.adjoint(frames[:, -1]), 1, 2), *([] if base_known else [rigid])]
        twists = np.concatenate([*known, self.parameter_twists(frames, q).reshape(len(q), -1, 6)], axis=1)
        weight = np.array([1.0, 1.0, 1.0, *[self.reach] * 3])  # rotations as displacements at the reach
        columns = (np.swapaxes(twists, 0, 1) * weight).reshape(twists.shape[1], -1)
        columns /= np.linalg.norm(columns, axis=1, keepdims=True)
        first = twists.shape[1] - 5 * self.n
        order = [first + 5 * i + k for k in (3, 0, 2, 1, 4) for i in reversed(range(self.n))]
        basis, free = np.linalg.qr(columns[:first].T)[0], np.zeros(5 * self.n, dtype=bool)
        for at in order:
            left = columns[at] - basis @ (basis.T @ columns[at])
            left -= basis @ (basis.T @ left)
            if (size := float(np.linalg.norm(left))) > tolerance:
                basis, free[at - first] = np.column_stack([basis, left / size]), True
        return ~free.reshape(-1, 5)

    def frames(self, q: np.ndarray, displacement: np.ndarray | None = None) -> np.ndarray:
        """T_base_link for all links: (P, n+1, 4, 4); [:, 0] is the base, [:, n] the flange.

        q: (P, n) rad, mm of a prismatic joint. displacement: (P, n+1, 6) local twists applied behind each frame (0: base, n: flange), or
        None.
        """
        step = self.link_transforms(q)
        out = np.empty((len(q), self.n + 1, 4, 4), dtype=step.dtype)
        out[:, 0] = self._first if displacement is None else self._first @ se3.exp(displacement[:, 0])
        for i in range(self.n):
            out[:, i + 1] = out[:, i] @ step[:, i]
            if displacement is not None:
                out[:, i + 1] = out[:, i + 1] @ se3.exp(displacement[:, i + 1])
        return out

    def flange(self, q: np.ndarray) -> np.ndarray:
        """T_base_flange (P, 4, 4) for q (P, n) rad, mm."""
        return self.frames(q)[:, -1]

    def link_transforms(self, q: np.ndarray) -> np.ndarray:
        """H_i(q_i): (P, n, 4, 4)."""
        angle, along = self._positions(q)
        ct, st = np.cos(angle), np.sin(angle)
        ca, sa = np.cos(self.alpha), np.sin(self.alpha)
        cb, sb = np.cos(self.beta), np.sin(self.beta)
        H = np.zeros((*angle.shape, 4, 4), dtype=angle.dtype)
        H[..., 0, 0], H[..., 0, 1], H[..., 0, 2] = ct * cb - st * sa * sb, -st * ca, ct * sb + st * sa * cb
        H[..., 1, 0], H[..., 1, 1], H[..., 1, 2] = st * cb + ct * sa * sb, ct * ca, st * sb - ct * sa * cb
        H[..., 2, 0], H[..., 2, 1], H[..., 2, 2] = -ca * sb, sa, ca * cb
        H[..., 0, 3], H[..., 1, 3], H[..., 2, 3], H[..., 3, 3] = self.a * ct, self.a * st, along, 1.0
        return H

    def _positions(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle about and displacement along z of the frame before each joint, (P, n) or (n,) each, at q (P, n)."""
        q = q @ self.coupling.T if self.follows else q
        angle, along = self.sign * q + self.theta, self.d
        if self.sliding:
            slides = list(self.sliding)
            angle[..., slides], along = self.theta[slides], np.broadcast_to(self.d, q.shape).astype(angle.dtype)
            along[..., slides] += self.sign[slides] * q[..., slides]
        return angle, along

    def joint_twists(self, frames: np.ndarray) -> np.ndarray:
        """Spatial twist of a unit of controller position of each joint: (P, n, 6)."""
        z = frames[:, :-1, :3, 2]
        out = rotation_twist(z, frames[:, :-1, :3, 3])
        if self.sliding:
            out[:, self.sliding, :3], out[:, self.sliding, 3:] = z[:, self.sliding], 0.0
        return self.of_leaders(self.sign[:, None] * out)

    def of_joints(self, parameter_twists: np.ndarray) -> np.ndarray:
        """Spatial twist of a unit of controller position of each joint (P, n, 6), from those of the parameters (P, n, 5, 6)."""
        out = parameter_twists[:, :, 0] * self.sign[:, None]
        if self.sliding:
            out[:, self.sliding] = parameter_twists[:, self.sliding, 1] * self.sign[list(self.sliding), None]
        return self.of_leaders(out)

    def parameter_twists(self, frames: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Spatial twist of a unit error of each MD-H parameter: (P, n, 5, 6), order of PARAMETERS.

        theta and d act about and along z of the frame before the link, a and alpha along and about x of the rotated frame,
        beta about y of the link's own frame. Valid for frames computed without displacement.
        """
        before, after = frames[:, :-1], frames[:, 1:]
        z, origin, tip = before[..., :3, 2], before[..., :3, 3], after[..., :3, 3]
        angle, _ = self._positions(q)
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
