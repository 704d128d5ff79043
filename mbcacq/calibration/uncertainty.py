"""How well the calibrated cell places a point, or a distance, anywhere in the workspace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated import Calibrated
from mbcacq.calibration.calibration_fit import CalibrationFit
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import identifiability
from mbcacq.geometry import se3


def frames(calibration: Calibrated, q: np.ndarray) -> np.ndarray:
    """(P, n+1, 4, 4) frames of the calibrated arm, with its effects, at joint angles q (P, n) rad as the controller reports them."""
    chain, effects = calibration.state.chain, calibration.effects
    return effects.frames(chain, q) if effects else chain.frames(q)


def to_base(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Scanner points xyz (P, 3) mm seen from postures q (P, n) rad, in the base frame (P, 3)."""
    T = frames(calibration, q)[:, -1] @ calibration.state.T_flange_scanner
    return se3.apply(T, corrected_points(calibration, q, xyz))


def corrected_points(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Scanner points xyz (P, 3) mm without what effects of the scanner add to them. The bias is taken at the measured point: it changes
    by a millionth of itself over its own size.
    """
    effects = calibration.effects
    if not effects:
        return xyz
    one = effects.poses(q)
    index = np.arange(len(q))
    moved = effects.displacements(replace(one, pose=index, ball=np.zeros(len(q), dtype=int), xyz=np.asarray(xyz, dtype=float)))
    return xyz if moved is None or moved.point is None else xyz - moved.point


def point_columns(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Derivative (P, 3, g) of the base position of xyz (P, 3), seen from q (P, n), by the free parameters, effects included."""
    A = identifiability.base_columns(calibration.layout, calibration.state, q, xyz[:, None])[0]
    if calibration.effects:
        _fill_effects(calibration, calibration.effects, q, xyz, A)
    return A


def _fill_effects(calibration: Calibrated, effects: EffectModel, q: np.ndarray, xyz: np.ndarray, A: np.ndarray) -> None:
    """Derivatives by the coefficients of the effects, into their columns of A (P, 3, g)."""
    position = {name: j for j, name in enumerate(calibration.layout.names)}
    index = np.arange(len(q))
    obs = replace(effects.poses(q), pose=index, ball=np.zeros(len(q), dtype=int), xyz=np.asarray(xyz, dtype=float))
    here = Covariates(obs)
    F = calibration.state.chain.frames(q)
    T = F[:, -1] @ calibration.state.T_flange_scanner
    point = se3.apply(T, xyz)
    joints = calibration.state.chain.joint_twists(F)
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


def measuring_covariance(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(P, 3, 3) mm^2 in the base: scanner noise and joint repeatability of one measurement."""
    seen, moved = measuring_terms(calibration, q, xyz)
    return seen + moved


def measuring_terms(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scanner noise, and joint repeatability, of one measurement: (P, 3, 3) mm^2 each, in the base."""
    state, noise = calibration.state, calibration.noise
    frames = state.chain.frames(q)
    T = frames[:, -1] @ state.T_flange_scanner
    point = se3.apply(T, xyz)
    twists = state.chain.joint_twists(frames)
    joint = (twists[..., :3] + np.cross(twists[..., 3:], point[:, None])) * noise.joint[:, None]
    turned = T[:, :3, :3] * noise.point
    return turned @ np.swapaxes(turned, 1, 2), np.swapaxes(joint, 1, 2) @ joint


def point_covariance(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray, *, measuring: bool = False) -> np.ndarray:
    """(P, 3, 3) mm^2 covariance in the base of scanner points xyz (P, 3) seen from postures q (P, n); with ``measuring`` including the
    noise of that one measurement. The base is where the held parameters (theta_1, d_1) put it."""
    A = point_columns(calibration, q, xyz)
    covariance = A @ calibration.covariance @ np.swapaxes(A, 1, 2)
    return covariance + measuring_covariance(calibration, q, xyz) if measuring else covariance


def distance_uncertainty(
    calibration: Calibrated,
    qa: np.ndarray,
    a: np.ndarray,
    qb: np.ndarray,
    b: np.ndarray,
    *,
    repeats: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """(P,) mm standard uncertainty of the distance between point a (P, 3) seen from qa and b seen from qb.

    repeats: how many poses each end was averaged over, to include the noise of measuring; None: the cell's parameters only.
    """
    u, row = distance_rows(calibration, qa, a, qb, b)
    variance = np.einsum("pg,gh,ph->p", row, calibration.covariance, row)
    if repeats is not None:
        for q, x, count in ((qa, a, repeats[0]), (qb, b, repeats[1])):
            variance = variance + np.einsum("pi,pij,pj->p", u, measuring_covariance(calibration, q, x), u) / count
    return np.sqrt(variance)


def common_distance_uncertainty(calibration: Calibrated, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> float:
    """mm standard uncertainty, from the cell's parameters alone, of the mean of the errors of these distances: what all of them share."""
    mean = distance_rows(calibration, qa, a, qb, b)[1].mean(axis=0)
    return float(np.sqrt(mean @ calibration.covariance @ mean))


def distance_rows(calibration: Calibrated, qa: np.ndarray, a: np.ndarray, qb: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (P, 3) from a to b, and derivatives (P, g) of their distance by the free parameters."""
    pa, pb = to_base(calibration, qa, a), to_base(calibration, qb, b)
    u = (pb - pa) / np.linalg.norm(pb - pa, axis=1, keepdims=True)
    return u, np.einsum("pi,pig->pg", u, point_columns(calibration, qb, b) - point_columns(calibration, qa, a))


def expected_accuracy(calibration: CalibrationFit, postures: int = 300, seed: int = 1) -> float:
    """rms (mm) over postures within the joint limits of the uncertainty of a measured point, effects included, a rigid motion of everything
    aside."""
    obs, state, layout = calibration.observations, calibration.state, calibration.layout
    if not calibration.effects:
        information = identifiability.workspace_information(obs, state, layout, postures, seed)
        return float(np.sqrt(max(np.sum(information * calibration.covariance), 0.0)))
    seen = identifiability.typical_points(obs)
    low, high = state.chain.drawn_between(obs.cell.robot.limits)
    drawn = np.random.default_rng(seed).uniform(low, high, size=(postures, obs.cell.robot.n))
    q, xyz = np.repeat(drawn, len(seen), axis=0), np.tile(seen, (postures, 1))
    A = point_columns(calibration, q, xyz).reshape(3 * len(q), -1)
    points = to_base(calibration, q, xyz)
    rigid = np.concatenate([np.tile(np.eye(3), (len(q), 1, 1)), -1e-3 * se3.skew(points)], axis=2).reshape(3 * len(q), 6)
    A = A - rigid @ np.linalg.lstsq(rigid, A, rcond=None)[0]
    return float(np.sqrt(max(np.sum((A @ calibration.covariance) * A), 0.0) / len(q)))


def predict_uncertainty(calibration: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(P,) mm: 3D standard uncertainty of scanner points xyz (P, 3) brought into the base from postures q (P, n)."""
    return np.sqrt(np.trace(point_covariance(calibration, q, xyz), axis1=1, axis2=2))
