"""The true arm: its axes as lines in space, moved one after the other (product of exponentials).

Brockett's formula: T_base_flange(q) = E_1(q_1) ... E_n(q_n) M, E_i the rotation about the i-th axis line as it lies at q = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.world.rigid import carry, displacement, invert, rigid, rotation_about, screw

X, Y, Z = np.eye(3)
STANDARD_GRAVITY = 9.80665  # m/s^2

# Zhou et al. 2025, Table 1: identified errors of the six rows; deg and mm. d_2 is redundant there, beta exists for row 2 only.
PAPER_TABLE_1 = {
    "theta_deg": (0.021, -0.017, 0.031, -0.041, 0.027, -0.024),
    "d_mm": (0.454, 0.0, -0.217, 0.067, -0.081, 0.102),
    "a_mm": (0.143, -0.261, 0.051, 0.0268, -0.002, 0.036),
    "alpha_deg": (0.007, 0.002, -0.013, 0.001, -0.014, 0.021),
    "beta_deg": (0.0, 0.008, 0.0, 0.0, 0.0, 0.0),
}


def paper_errors() -> np.ndarray:
    """Table 1 as (6, 5): theta rad, d mm, a mm, alpha rad, beta rad."""
    table = PAPER_TABLE_1
    return np.stack(
        [np.radians(table["theta_deg"]), table["d_mm"], table["a_mm"], np.radians(table["alpha_deg"]), np.radians(table["beta_deg"])],
        axis=1,
    )


@dataclass(frozen=True)
class TrueArm:
    """axis, point: (n, 3) joint lines at q = 0 in the base frame, directed so that a positive controller angle turns about them.
    zero: (n + 1, 4, 4) frames behind each link at q = 0, base first, flange last. slides: (n,) bool: the joint moves along its line, mm.
    """

    axis: np.ndarray
    point: np.ndarray
    zero: np.ndarray
    slides: np.ndarray

    @classmethod
    def from_rows(cls, sign: np.ndarray, rows: np.ndarray, slides: np.ndarray | None = None, root: np.ndarray | None = None) -> TrueArm:
        """From MD-H rows (n, 5) theta, d, a, alpha, beta (rad, mm) and the sign (n,) of the direction in which the controller counts.

        slides: (n,) bool; root: (4, 4) where the first joint's line is z.
        """
        zero = [np.eye(4) if root is None else root]
        for theta, d, a, alpha, beta in np.asarray(rows, dtype=float):
            about_z = rigid(rotation_about(Z, theta), d * Z)
            zero.append(zero[-1] @ about_z @ rigid(rotation_about(X, alpha), a * X) @ rigid(rotation_about(Y, beta), np.zeros(3)))
        zero = np.array(zero)
        still = np.zeros(len(zero) - 1, dtype=bool) if slides is None else slides
        return cls(np.asarray(sign, dtype=float)[:, None] * zero[:-1, :3, 2], zero[:-1, :3, 3].copy(), zero, still)

    @property
    def n(self) -> int:
        return len(self.axis)

    def frames(self, q: np.ndarray, moved: np.ndarray | None = None) -> np.ndarray:
        """T_base_link (P, n + 1, 4, 4) at controller angles q (P, n) rad; the last is the flange.

        moved: (P, n + 1, 6) what displaces each frame in itself: shift mm, rotation vector rad; first the base, last the mount.
        """
        out = np.empty((len(q), self.n + 1, 4, 4))
        so_far = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for i in range(self.n + 1):
            if i and self.slides[i - 1]:
                so_far = so_far @ displacement(q[:, i - 1, None] * self.axis[i - 1], np.zeros((len(q), 3)))
            elif i:
                so_far = so_far @ screw(self.axis[i - 1], self.point[i - 1], q[:, i - 1])
            if moved is not None and np.any(moved[:, i]):
                so_far = so_far @ (self.zero[i] @ displacement(moved[:, i, :3], moved[:, i, 3:]) @ invert(self.zero[i]))
            out[:, i] = so_far @ self.zero[i]
        return out

    def flange(self, q: np.ndarray) -> np.ndarray:
        return self.frames(q)[:, -1]


@dataclass(frozen=True)
class Masses:
    """mass (n,) kg, com (n, 3) mm in each link's frame; payload_com (3,) mm in the flange frame; gravity (3,) unit, base frame."""

    mass: np.ndarray
    com: np.ndarray
    payload_mass: float
    payload_com: np.ndarray
    gravity: np.ndarray

    def weights(self, arm: TrueArm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres of mass (P, n + 1, 3) mm in the base frame, payload last, and their masses (n + 1,) kg."""
        frames = arm.frames(q)
        com = np.concatenate([self.com, self.payload_com[None]])[:, None]
        return carry(np.concatenate([frames[:, 1:], frames[:, -1:]], axis=1), com)[:, :, 0], np.append(self.mass, self.payload_mass)

    def energy(self, arm: TrueArm, q: np.ndarray) -> np.ndarray:
        """Potential energy (P,) J."""
        centres, mass = self.weights(arm, q)
        return -STANDARD_GRAVITY * 1e-3 * np.einsum("pkc,k,c->p", centres, mass, self.gravity)

    def torque(self, arm: TrueArm, q: np.ndarray, step: float = 1e-4) -> np.ndarray:
        """What gravity exerts on each joint (P, n) N m with the controller's signs: minus the slope of the energy."""
        offset = step * np.concatenate([-np.eye(arm.n), np.eye(arm.n)])[:, None]
        before, after = self.energy(arm, (q + offset).reshape(-1, arm.n)).reshape(
            2, arm.n, len(q)
        )  # all in one go: most calls are of one q
        return (before - after).T / (2 * step)
