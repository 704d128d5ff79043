"""Arms that err beyond their geometry, by laws written as plain formulas: what they measured, and where their centres truly are.

Independent of the program's effects: gravity torques are finite differences of the potential energy of point masses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from cells import kr10, random_errors, scanner_cell

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.estimation import forward_model
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations

NOISE, JOINT = (0.005, 0.005, 0.009), 8e-6  # mm, rad: of the scanner and of the joints in good order

MASS = np.array([50.0, 35, 30, 10, 6, 3])  # kg, point masses in the middle of the links; 8 kg 100 mm before the flange


def torque(chain: Chain, q: np.ndarray) -> np.ndarray:
    """(P, n) N m of gravity about the joints: the potential energy of point masses, differentiated by finite differences."""

    def energy(q: np.ndarray) -> np.ndarray:
        F = chain.frames(q)
        middle = 0.5 * (F[:, :-1, :3, 3] + F[:, 1:, :3, 3])
        return 9.80665e-3 * (middle[:, :, 2] @ MASS + 8 * (F[:, -1, 2, 3] + 100 * F[:, -1, 2, 2]))

    h = 1e-6
    return np.stack([(energy(q - e) - energy(q + e)) / (2 * h) for e in h * np.eye(q.shape[1])], axis=1)


def at(n: int, **of: np.ndarray) -> np.ndarray:
    """(P, n) rad: errors of the joints that are named, 'a2' for A2."""
    out = np.zeros((len(next(iter(of.values()))), n))
    for name, value in of.items():
        out[:, int(name[1:]) - 1] = value
    return out


def moment(chain: Chain, q: np.ndarray, frame: int, aside: float = 0.0) -> np.ndarray:
    """(P, 3) N m of the weight behind a frame about its origin, in its axes. aside: mm by which the tool's weight is off the last axis."""
    F = chain.frames(q)
    middle = 0.5 * (F[:, frame:-1, :3, 3] + F[:, frame + 1 :, :3, 3]) - F[:, frame, None, :3, 3]
    tip = F[:, -1, :3, 3] + 100 * F[:, -1, :3, 2] + aside * F[:, -1, :3, 0] - F[:, frame, :3, 3]
    first = np.einsum("pij,i->pj", middle, MASS[frame:]) + 8 * tip
    return np.einsum("pji,pj->pi", F[:, frame, :3, :3], np.cross(first, [0.0, 0.0, -9.80665e-3]))


def frame_at(q: np.ndarray, frame: int, component: int, by: np.ndarray) -> np.ndarray:
    """(P, n + 1, 6) of which one frame is turned or shifted."""
    out = np.zeros((*q.shape[:1], q.shape[1] + 1, 6))
    out[:, frame, component] = by
    return out


# (P, n) rad by which the joints err, or (P, n + 1, 6) mm and rad by which the frames behind the links do.
Law = Callable[[Chain, np.ndarray, np.ndarray], np.ndarray]
LAWS: dict[str, Law] = {
    "nothing further": lambda c, q, d: np.zeros_like(q),
    "elastic A2, A4": lambda c, q, d: at(6, a2=1.2e-6 * torque(c, q)[:, 1], a4=6e-6 * torque(c, q)[:, 3]),
    "backlash of A2, A3, directions recorded": lambda c, q, d: at(6, a2=1e-4 * d[:, 1], a3=7e-5 * d[:, 2]),
    "gear errors of orders 2 to 4": lambda c, q, d: at(
        6, a1=5e-5 * np.sin(4 * q[:, 0]), a2=6e-5 * np.sin(2 * q[:, 1] + 1), a3=7e-5 * np.sin(3 * q[:, 2] + 2)
    ),
    "motion that goes with another axis": lambda c, q, d: at(6, a5=2e-4 * q[:, 3], a6=3e-4 * q[:, 4]),
    "a product of two angles": lambda c, q, d: at(6, a3=1.5e-4 * np.sin(q[:, 1]) * np.cos(q[:, 4])),
    "gear errors of orders 17 and 22": lambda c, q, d: at(6, a2=8e-5 * np.sin(17 * q[:, 1]), a3=8e-5 * np.sin(22 * q[:, 2] + 1)),
    "eccentric encoders of A3, A5": lambda c, q, d: at(6, a3=2e-4 * np.sin(q[:, 2] + 1), a5=2e-4 * np.sin(q[:, 4] + 2)),
    "a torque that stiffens A2": lambda c, q, d: at(6, a2=2e-4 * np.tanh(torque(c, q)[:, 1] / 150)),
    "a link that twists by a tool with its weight aside": lambda c, q, d: frame_at(q, 2, 3, 2e-5 * moment(c, q, 2, 150.0)[:, 0]),
    "a base that tilts": lambda c, q, d: frame_at(q, 0, 4, 4e-7 * moment(c, q, 0)[:, 1]),
    "a mount with clearance": lambda c, q, d: frame_at(q, 6, 0, 0.08 * np.sign(c.frames(q)[:, -1, 2, 0])),
    "gear errors of orders 57 and 101": lambda c, q, d: at(6, a2=1e-4 * np.sin(57 * q[:, 1]), a3=1e-4 * np.sin(101 * q[:, 2])),
}


def erring_arm(law: Law, seed: int, places: int = 8, further: int = 6) -> tuple[Observations, Observations, np.ndarray]:
    """A recording to learn from, exact poses at further places, and where their centres truly are in the base."""
    rng = np.random.default_rng(seed)
    cell = scanner_cell(rng, stations=places + further, per_station=12, errors=random_errors(kr10(), rng))
    obs, direction = cell.observations, np.sign(rng.normal(size=cell.observations.q.shape))
    middle = 0.5 * np.linalg.inv(obs.cell.robot.chain.link_transforms(np.zeros((1, 6)))[0])[:, :3, 3]
    tool = np.array([150.0 if "aside" in law_name(law) else 0.0, 0, 100])
    robot = replace(obs.cell.robot, mass=MASS, com=middle, payload_mass=8.0, payload_com=tool)
    obs = replace(obs, cell=replace(obs.cell, robot=robot), direction=direction if "directions" in law_name(law) else None)
    off = law(cell.truth.chain, obs.q, direction)
    joint, frame = (off, None) if off.ndim == 2 else (np.zeros_like(obs.q), off)
    exact = forward_model.predict(obs, cell.truth, forward_model.Displacements(joint=joint, frame=frame)).xyz
    noisy = forward_model.Displacements(joint=joint + rng.normal(size=joint.shape) * JOINT, frame=frame)
    xyz = forward_model.predict(obs, cell.truth, noisy).xyz + rng.normal(size=exact.shape) * NOISE
    new = obs.station >= places
    T = cell.truth.chain.frames(obs.q + joint, frame)[:, -1] @ cell.truth.T_flange_scanner
    return replace(obs, xyz=xyz).select(~new), replace(obs, xyz=exact).select(new), se3.apply(T[obs.pose], exact)[new[obs.pose]]


def law_name(law: Law) -> str:
    return next(name for name, one in LAWS.items() if one is law)


def placed_wrong(found: CalibratedCell, obs: Observations, truth: np.ndarray) -> float:
    """3D rms (um) of centres at new places from where they are, after the best rigid motion."""
    frames = found.effects.frames(found.state.chain, obs.q, obs) if found.effects else found.state.chain.frames(obs.q)
    p = se3.apply((frames[:, -1] @ found.state.T_flange_scanner)[obs.pose], obs.xyz)
    a, b = p - p.mean(axis=0), truth - truth.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    R = (u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return 1e3 * float(np.sqrt(np.mean(np.sum((a @ R.T - b) ** 2, axis=1))))
