"""Joint torque by gravity of a serial arm."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

STANDARD_GRAVITY = 9.80665  # m/s^2


def gravity_torque(
    chain: Chain,
    frames: np.ndarray,
    mass: np.ndarray,
    com: np.ndarray,
    payload_mass: float | np.ndarray,
    payload_com: np.ndarray,
    gravity: np.ndarray,
) -> np.ndarray:
    """Torque that gravity exerts about each joint axis, or force along a prismatic one, counted in the controller's direction.

    frames: (P, n+1, 4, 4) from ``Chain.frames``; mass: (n,) kg; com: (n, 3) mm in the frame of each link;
    payload_mass: kg, one number or one a pose (P,); payload_com: (3,) mm in the flange frame; gravity: (3,) unit vector
    in the base at zero, pointing down. Returns (P, n) N m, N of a prismatic joint; zero for joints that carry the artefact.
    """
    weight = STANDARD_GRAVITY * downward(chain, frames, gravity)
    centres = se3.apply(frames[:, 1:], com[None])
    payload = se3.apply(frames[:, -1], np.broadcast_to(payload_com, (len(frames), 3)))
    load = np.broadcast_to(np.asarray(payload_mass, dtype=float), (len(frames),))
    axis = chain.sign[:, None] * frames[:, :-1, :3, 2]
    origin = frames[:, :-1, :3, 3]
    # Everything distal to joint i hangs on it: suffix sums of mass and of first moment.
    moment = np.cumsum((mass[:, None] * centres)[:, ::-1], axis=1)[:, ::-1] + (load[:, None] * payload)[:, None]
    total = np.cumsum(mass[::-1])[::-1] + load[:, None]
    arm = moment - total[..., None] * origin
    out = np.einsum("pij,pij->pi", axis, np.cross(arm, weight)) * 1e-3
    if chain.sliding:
        out[:, chain.sliding] = (np.sum(axis * weight, axis=2) * total)[:, chain.sliding]
    out[:, : chain.floor] = 0.0
    return chain.of_leaders(out[..., None])[..., 0]


def downward(chain: Chain, frames: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """What points down, given (3,) in the base at zero of the axes of a table, in the base: (3,), or (P, 1, 3) where it is a table."""
    g = np.asarray(gravity, dtype=float)
    if not chain.floor:
        return g
    at_zero = chain.frames(np.zeros((1, chain.n)))[0, chain.floor, :3, :3]
    return (frames[:, chain.floor, :3, :3] @ at_zero.T @ g)[:, None]


def upright_angle(chain: Chain, gravity: np.ndarray) -> float | None:
    """Angle of the second axis that turns the arm at which the third joint is highest above the second; None where it does not lift it."""
    H = chain.link_transforms(np.zeros((1, chain.n)))[0, chain.first_turning :]
    axis, up = H[0, :3, :3] @ np.array([0.0, 0.0, 1.0]), -np.asarray(gravity)
    lever = H[0, :3, :3] @ H[1, :3, 3]
    lever, up = lever - axis * (axis @ lever), up - axis * (axis @ up)
    if np.linalg.norm(lever) < 1.0 or np.linalg.norm(up) < 0.1:
        return None
    turn = float(np.arctan2(axis @ np.cross(lever, up), lever @ up) * chain.sign[chain.first_turning + 1])
    return (turn + np.pi) % (2 * np.pi) - np.pi
