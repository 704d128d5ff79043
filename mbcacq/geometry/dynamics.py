"""Torque of a rigid arm in motion, linear in its inertial parameters.

Per link: mass (kg), first moment m c (kg m) and inertia about the link frame's origin (kg m^2), all in the link frame.
"""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.gravity import STANDARD_GRAVITY

STATED_SHARE = 0.1  # by which public masses and centres of gravity are off
LEAST_TOOL_KG, TOOL_SHARE = 1.0, 0.2  # prior sigma of an undescribed tool: robots carry up to a fifth of their own mass
TOOL_LEVER_M, TOOL_RADIUS_M = 0.2, 0.15  # prior sigma of its centre of gravity, and of its radius of gyration
INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


def regressor(chain: Chain, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Drive torque per inertial parameter: (T, n, n, 10) N m, N of a prismatic joint, per unit of link l's parameter k, recursive
    Newton-Euler.

    q, qd, qdd: (T, n) rad, rad/s, rad/s^2 (mm, mm/s, mm/s^2), counted in the controller's direction; gravity: (3,) unit vector in the frame
    of the floor. The torque counts in the same direction and is what the drives must exert; zero at joints that carry the artefact.
    """
    H = chain.link_transforms(q)
    R, t = H[..., :3, :3], H[..., :3, 3] * 1e-3
    T, n = q.shape
    qd, qdd = (x @ chain.coupling.T if chain.follows else x for x in (qd, qdd))
    out = np.zeros((T, n, n, 10))
    omega, alpha = np.zeros((T, 3)), np.zeros((T, 3))
    acceleration = np.broadcast_to(-STANDARD_GRAVITY * np.asarray(gravity, dtype=float), (T, 3))
    axis = np.array([0.0, 0.0, 1.0])
    for link in range(chain.floor, n):
        # The axis is z of the frame before the link; everything is then turned into the link's own frame.
        rate, jolt = (chain.sign[link] * qd[:, link])[:, None] * axis, (chain.sign[link] * qdd[:, link])[:, None] * axis
        if link in chain.sliding:
            acceleration = acceleration + 1e-3 * (jolt + 2 * se3.cross(omega, rate))
        else:
            alpha = alpha + jolt + se3.cross(omega, rate)
            omega = omega + rate
        lever = t[:, link]
        acceleration = acceleration + se3.cross(alpha, lever) + se3.cross(omega, se3.cross(omega, lever))
        back = np.swapaxes(R[:, link], -1, -2)
        omega, alpha, acceleration = (np.einsum("tij,tj->ti", back, v) for v in (omega, alpha, acceleration))
        force, moment = _wrench(omega, alpha, acceleration)
        for joint in range(link, chain.floor - 1, -1):
            force = R[:, joint] @ force
            moment = R[:, joint] @ moment + se3.skew(t[:, joint]) @ force
            out[:, joint, link] = chain.sign[joint] * (force if joint in chain.sliding else moment)[:, 2]
    return chain.of_leaders(out.reshape(T, n, -1)).reshape(out.shape)


def _wrench(omega: np.ndarray, alpha: np.ndarray, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment (T, 3, 10) about the link frame's origin by unit inertial parameters."""
    T = len(omega)
    force, moment = np.zeros((T, 3, 10)), np.zeros((T, 3, 10))
    force[:, :, 0] = acceleration
    for k in range(3):
        unit = np.broadcast_to(np.eye(3)[k], (T, 3))
        force[:, :, 1 + k] = se3.cross(alpha, unit) + se3.cross(omega, se3.cross(omega, unit))
        moment[:, :, 1 + k] = se3.cross(unit, acceleration)
    for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), start=4):
        tensor = np.zeros((3, 3))
        tensor[i, j] = tensor[j, i] = 1.0
        spin = omega @ tensor
        moment[:, :, k] = alpha @ tensor + se3.cross(omega, spin)
    return force, moment


def nominal_parameters(mass: np.ndarray, com: np.ndarray, payload_mass: float = 0.0, payload_com: np.ndarray | None = None) -> np.ndarray:
    """(n, 10) of links as point masses: mass (n,) kg, com (n, 3) mm; the payload rides on the last link."""
    c = com * 1e-3
    out = _point_masses(mass, c)
    if payload_mass:
        out[-1] += _point_masses(np.array([payload_mass]), np.asarray(payload_com, dtype=float)[None] * 1e-3)[0]
    return out


def inertial_sigma(robot) -> np.ndarray:
    """How far the inertial parameters (n, 10) of a robot's description may be off (one sigma).

    Stated masses and centres may be off by a share; inertia tensors, which it does not state, by as much as the link's size allows; without
    masses all of it is unknown.
    """
    stated = robot.mass.any()
    mass = np.maximum(robot.mass, 0.05 * max(robot.mass.sum(), 20.0))
    size = np.maximum(np.abs(robot.chain.a) + np.abs(robot.chain.d), 100.0) * 1e-3
    lever = np.maximum(np.linalg.norm(robot.com, axis=1) * 1e-3, 0.25 * size)
    share = STATED_SHARE if stated else 3.0
    return mass[:, None] * np.stack([np.full_like(size, share), *[share * lever] * 3, *[0.1 * size**2] * 6], axis=1)


def tool_sigma(robot) -> np.ndarray:
    """Prior standard deviations (10,) of the inertial parameters of an undescribed tool of a robot."""
    mass = max(LEAST_TOOL_KG, TOOL_SHARE * float(robot.mass.sum()))
    return mass * np.array([1.0, *[TOOL_LEVER_M] * 3, *[TOOL_RADIUS_M**2] * 6])


def _point_masses(mass: np.ndarray, c: np.ndarray) -> np.ndarray:
    x, y, z = c.T
    columns = [np.ones_like(x), x, y, z, y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    return mass[:, None] * np.stack(columns, axis=1)
