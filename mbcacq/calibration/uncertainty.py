"""Derivatives of a measured point, and the noise of measuring it: what the uncertainty of a calibrated cell is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations


def single_points(effects: EffectModel, q: np.ndarray, xyz: np.ndarray) -> Observations:
    """Scanner points xyz (P, 3) mm, one seen from each posture q (P, n) rad, as observations at which effects can be evaluated."""
    index = np.arange(len(q))
    return replace(effects.poses(q), pose=index, ball=np.zeros(len(q), dtype=int), xyz=np.asarray(xyz, dtype=float))


def fill_effect_columns(
    A: np.ndarray, names: Sequence[str], state: CellState, effects: EffectModel, q: np.ndarray, xyz: np.ndarray
) -> None:
    """Write the derivatives of the base position of xyz (P, 3) mm, seen from q (P, n) rad, by the coefficients of effects into A.

    Parameters
    ----------
    A : ndarray
        (P, 3, g), changed in place.
    names : sequence of str
        Names of its g columns; effects that are not among them are held.
    """
    position = {name: j for j, name in enumerate(names)}
    here = Covariates(single_points(effects, q, xyz))
    F = state.chain.frames(q)
    T = F[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    joints = state.chain.joint_twists(F)
    for one in effects.terms:
        if one.names[0] not in position:
            continue  # held
        columns = np.zeros((len(q), 3, one.k))
        for part in one.parts_at(here, effects.learnt):
            if part.place in ("joint", "frame"):
                twist = joints[:, part.index] if part.place == "joint" else se3.adjoint(F[:, part.index])[:, :, part.component]
                moved = twist[:, :3] + np.cross(twist[:, 3:], point)
                columns += moved[:, :, None] * part.basis[:, None, :]
            elif part.place == "point":
                columns -= T[:, :3, part.component, None] * part.basis[:, None, :]
        A[:, :, [position[name] for name in one.names]] = columns


def measuring_terms(state: CellState, noise: Noise, q: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scanner noise, and joint repeatability, of one measurement: (P, 3, 3) mm^2 each, in the base."""
    frames = state.chain.frames(q)
    T = frames[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    twists = state.chain.joint_twists(frames)
    joint = (twists[..., :3] + np.cross(twists[..., 3:], point[:, None])) * noise.joint[:, None]
    turned = T[:, :3, :3] * noise.point
    return turned @ np.swapaxes(turned, 1, 2), np.swapaxes(joint, 1, 2) @ joint


def without_rigid_motion(A: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivatives A (P, 3, g) of points (P, 3) mm less the rigid motion of all points together that explains each column best: the base
    is wherever the stations put it."""
    rigid = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -1e-3 * se3.skew(points)], axis=2).reshape(-1, 6)
    flat = A.reshape(-1, A.shape[2])
    normal = np.linalg.pinv(rigid.T @ rigid, rcond=1e-12, hermitian=True)  # well-conditioned, and far quicker than a decomposition of rigid
    return A - (rigid @ (normal @ (rigid.T @ flat))).reshape(A.shape)
