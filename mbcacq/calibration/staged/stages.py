"""The stages before the distance constraint, on a recording: angle adjustment, and the hand-eye transform from one virtual point (Eq. 5-7),
its rotation from translations and its translation from orientations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.held_out_poses import ball_spread, rms
from mbcacq.calibration.staged import angle_adjustment
from mbcacq.calibration.staged.pair_distances import VIRTUAL_BALLS
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.initial_guess import hand_eye_from_fixed_points
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees


def adjust_angles(obs: Observations) -> tuple[Observations, list[dict], list[np.ndarray]]:
    """The recording with its centres corrected by the angle adjustment, all visible balls of each pose together; poses with fewer than
    three balls stay as they are. Poses that show the same balls share a ridge parameter. Last, per pose, (3 B, 3 B) what the
    adjustment leaves of small errors of its B centres, in their order."""
    certified, xyz = obs.cell.ball_centres, obs.xyz.copy()
    visible = np.zeros((obs.n_poses, len(certified)), bool)
    visible[obs.pose, obs.ball] = True
    curves = []
    smoother = [np.eye(3 * k) for k in np.bincount(obs.pose, minlength=obs.n_poses)]
    for mask in np.unique(visible, axis=0):
        poses = np.flatnonzero((visible == mask).all(axis=1))
        balls = np.flatnonzero(mask)
        rows = np.flatnonzero(np.isin(obs.pose, poses))
        if len(balls) < 3 or len(rows) != len(poses) * len(balls):
            continue
        rows = rows[np.lexsort((obs.ball[rows], obs.pose[rows]))].reshape(len(poses), len(balls))
        xyz[rows], curve, of_pose = angle_adjustment.adjust(obs.xyz[rows], certified[balls])
        for k, p in enumerate(poses):
            order = (3 * np.argsort(rows[k])[:, None] + np.arange(3)).ravel()
            smoother[p] = of_pose[k][np.ix_(order, order)]
        curves.append((len(poses), curve))
    adjusted = replace(obs, xyz=xyz)
    moved = np.sqrt(np.mean(np.sum((xyz - obs.xyz) ** 2, axis=1)))
    largest = max(curves, key=lambda c: c[0])[1] if curves else None
    stage = {"stage": "angle adjustment (Eq. 8-12)", "rms_correction_mm": float(moved)}
    stage |= {"rms_shape_before_mm": shape_error(obs), "rms_shape_after_mm": shape_error(adjusted)}
    if largest is not None:
        curve = {"ridge": largest.ridge, "misfit_rad": largest.misfit, "size_mm": largest.size}
        stage["l_curve"] = {**{name: values.tolist() for name, values in curve.items()}, "corner": largest.corner}
    return adjusted, [stage], smoother


def shape_error(obs: Observations) -> float:
    """rms (mm) of measured minus certified distances between the balls of each scan."""
    same = []
    for p in range(obs.n_poses):
        rows = np.flatnonzero(obs.pose == p)
        i, j = np.triu_indices(len(rows), 1)
        same.append(
            np.linalg.norm(obs.xyz[rows[i]] - obs.xyz[rows[j]], axis=1)
            - np.linalg.norm(obs.cell.ball_centres[obs.ball[rows[i]]] - obs.cell.ball_centres[obs.ball[rows[j]]], axis=1)
        )
    errors = np.concatenate(same)
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")


def preliminary(obs: Observations) -> tuple[np.ndarray, list[dict]]:
    """T_flange_scanner (4, 4) from the phases 'translation' and 'orientation' by a virtual point; without them, from points that
    stand still."""
    phases = set() if obs.phase is None else set(obs.phase.tolist())
    if not {"translation", "orientation"} <= phases:
        found = hand_eye_from_fixed_points(obs, obs.cell.robot.chain.flange(obs.q), obs.cell.T_flange_scanner)
        if found is None:
            raise CalibrationError(
                "the poses do not determine a first hand-eye transform for the paper's method; record its translations "
                "and orientations, or turn the scanner about two axes by 20° and more at a position"
            )
        stage = "hand-eye from fixed points (no translation and orientation phases recorded)"
        spread = ball_spread(obs, CellState(obs.cell.robot.chain, found, np.zeros((0, 4, 4)), obs.cell.ball_centres))
        return found, [{"stage": stage, "rms_virtual_point_mm": rms(spread)}]
    T, virtual = virtual_point(obs, obs.phase == "translation")
    R = rotation_from_translations(T, virtual)
    T_turned, virtual_turned = virtual_point(obs, obs.phase == "orientation")
    t = translation_from_orientations(T_turned, virtual_turned, R)
    X = se3.transform(R, t)
    guess = obs.cell.T_flange_scanner
    turned = se3.rotation_log(guess[:3, :3].T @ R)
    before, after = (_spread(T_turned @ one, virtual_turned) for one in (guess, X))
    moved = float(np.linalg.norm(t - guess[:3, 3]))
    changed = {"change_mm": moved, "rms_virtual_point_before_mm": before, "rms_virtual_point_after_mm": after}
    return X, [
        {"stage": "hand-eye rotation from translations (Eq. 7)", "poses": len(T), "change_deg": float(in_degrees(np.linalg.norm(turned)))},
        {"stage": "hand-eye translation from orientations", "poses": len(T_turned), **changed},
    ]


def virtual_point(obs: Observations, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T_base_flange (P, 4, 4) and the barycentre (P, 3) of the same four balls, of the poses chosen that show all four."""
    chosen = obs.select(which)
    count = np.bincount(chosen.ball, minlength=len(obs.cell.ball_ids))
    four = np.sort(np.argsort(-count, kind="stable")[:VIRTUAL_BALLS])
    rows = np.flatnonzero(np.isin(chosen.ball, four))
    whole = np.flatnonzero(np.bincount(chosen.pose[rows], minlength=chosen.n_poses) == VIRTUAL_BALLS)
    if len(whole) < 3:
        raise CalibrationError("fewer than three poses show the same four balls; the virtual point of the paper's method needs them")
    rows = rows[np.isin(chosen.pose[rows], whole)]
    points = chosen.xyz[rows].reshape(len(whole), VIRTUAL_BALLS, 3)
    return obs.cell.robot.chain.flange(chosen.q[whole]), points.mean(axis=1)  # Eq. 5


def _spread(T: np.ndarray, virtual: np.ndarray) -> float:
    base = se3.apply(T, virtual)
    return float(np.sqrt(np.mean(np.sum((base - base.mean(axis=0)) ** 2, axis=1))))


def rotation_from_translations(T_base_flange: np.ndarray, virtual: np.ndarray) -> np.ndarray:
    """R_flange_scanner (3, 3) from poses (P, 4, 4) of equal orientation that see one fixed point at ``virtual`` (P, 3) (Eq. 7).

    R (p_1 - p_i) = R_base_flange' (t_i - t_1), an orthogonal Procrustes problem (SVD, determinant +1), here about the means, so
    that no pose is special. Raises CalibrationError if the translations span less than a plane.
    """
    R = T_base_flange[:, :3, :3]
    moved = np.einsum("pji,pj->pi", R, T_base_flange[:, :3, 3] - T_base_flange[:, :3, 3].mean(axis=0))
    measured = -(virtual - virtual.mean(axis=0))
    spread = np.linalg.svd(measured, compute_uv=False)
    if len(virtual) < 3 or spread[1] < 1.0:
        raise CalibrationError(
            "the translations do not span a plane, which leaves the hand-eye rotation undetermined; "
            "translate along base X, Y and Z by 20 mm and more"
        )
    return se3.nearest_rotation(moved.T @ measured)


def translation_from_orientations(T_base_flange: np.ndarray, virtual: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """t_flange_scanner (3,) mm from poses (P, 4, 4) of different orientation that see one fixed point at ``virtual`` (P, 3).

    (R_i - R_j) t = t_j - t_i + R_j R p_j - R_i R p_i over all pairs, which is least squares about the means. Raises CalibrationError
    where the orientations turn about one axis only.
    """
    R, t = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    point = t + np.einsum("pij,jk,pk->pi", R, rotation, virtual)
    columns = (R - R.mean(axis=0)).reshape(-1, 3)
    size = np.linalg.svd(columns, compute_uv=False)
    if size[-1] < 0.02 * np.sqrt(len(R)):
        raise CalibrationError(
            "the orientations turn too little, or about one axis only, which leaves the hand-eye translation "
            "undetermined; turn about two axes by 10° and more"
        )
    return np.linalg.lstsq(columns, -(point - point.mean(axis=0)).reshape(-1), rcond=None)[0]
