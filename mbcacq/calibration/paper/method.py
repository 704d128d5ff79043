"""The stages in their order, on a recording: angle adjustment, virtual point, hand-eye rotation and translation, distance constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration import blocks
from mbcacq.calibration.blocks import Block, Estimate, Layout
from mbcacq.calibration.estimate import select_phases, with_all_stations
from mbcacq.calibration.forward import CellState
from mbcacq.calibration.linearise import Lineariser
from mbcacq.calibration.options import Noise, Options
from mbcacq.calibration.paper import angles, distance, hand_eye
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.solve import Weights
from mbcacq.calibration.start import hand_eye_from_fixed_points
from mbcacq.cell import TARGET_IN_BASE
from mbcacq.errors import CalibrationError
from mbcacq.geometry import se3
from mbcacq.observations import CENTRE_COLUMNS, Observations

VIRTUAL_BALLS = 4


def calibrate_paper(observations: Observations, options: Options) -> Calibration:
    """The published method on a recording. Raises CalibrationError where its stages lack what they need."""
    whole = select_phases(observations, options)
    obs = four_balls(whole)
    if obs.cell.measurement == TARGET_IN_BASE or not np.any(np.abs(obs.xyz) > 1e-9):
        raise CalibrationError("the paper's method needs a scanner on the flange that sees several balls at a pose; "
                               "use --method ml for this recording")
    adjusted, stages = adjust_angles(obs)
    X, more = preliminary(adjusted)
    nowhere = np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    first = with_all_stations(adjusted, CellState(obs.cell.robot.chain, X, nowhere, obs.cell.ball_centres))
    position = np.zeros(obs.n_poses, bool) if obs.phase is None else obs.phase == "position"
    where = adjusted.select(position) if position.any() else adjusted
    layout = published_layout(obs, options)
    free = np.concatenate([b.free for b in layout.blocks[:2]])
    at = distance.pairs(where.pose, where.station[where.pose], where.ball, obs.cell.ball_centres)
    if len(at.a) < free.sum():
        raise CalibrationError("too few pairs of balls were seen from different poses of one station for the distance constraint; "
                               "take several orientations at each position of the artefact")
    found = distance.identify(first.chain, X, where.q, where.pose, where.xyz, at, free)
    stages = [*stages, *more, {"stage": "distance constraint (Eq. 13-24)", "distances": len(at.a), "iterations": found.iterations,
                               "rms_distance_before_mm": found.rms_before, "rms_distance_after_mm": found.rms_after}]
    state = with_all_stations(obs, replace(first, chain=found.chain, T_flange_scanner=found.T_flange_scanner))
    return _as_calibration(obs, options, layout, state, first, found, stages)


def four_balls(obs: Observations) -> Observations:
    """The recording with four balls of each artefact, as the paper takes: those seen most often. Artefacts with fewer are left out."""
    count = np.bincount(obs.ball, minlength=len(obs.cell.ball_ids))
    keep = np.zeros(len(count), bool)
    for a in range(len(obs.cell.artefacts)):
        own = np.flatnonzero((obs.cell.ball_artefact == a) & (count > 0))
        if len(own) >= VIRTUAL_BALLS:
            keep[own[np.argsort(-count[own], kind="stable")[:VIRTUAL_BALLS]]] = True
    rows = keep[obs.ball]
    if not rows.any():
        return obs
    part = replace(obs, **{name: None if getattr(obs, name) is None else getattr(obs, name)[rows] for name in CENTRE_COLUMNS},
                   extra={k: v if k.startswith("poses.") else v[rows] for k, v in obs.extra.items()})
    return part.select(np.bincount(part.pose, minlength=part.n_poses) > 0)


def adjust_angles(obs: Observations) -> tuple[Observations, list[dict]]:
    """The recording with its centres corrected by the angle adjustment, all visible balls of each pose together; poses with fewer than
    three balls stay as they are. Poses that show the same balls share a ridge parameter."""
    certified, xyz = obs.cell.ball_centres, obs.xyz.copy()
    seen = np.zeros((obs.n_poses, len(certified)), bool)
    seen[obs.pose, obs.ball] = True
    curves = []
    for mask in np.unique(seen, axis=0):
        poses = np.flatnonzero((seen == mask).all(axis=1))
        balls = np.flatnonzero(mask)
        rows = np.flatnonzero(np.isin(obs.pose, poses))
        if len(balls) < 3 or len(rows) != len(poses) * len(balls):
            continue
        rows = rows[np.lexsort((obs.ball[rows], obs.pose[rows]))].reshape(len(poses), len(balls))
        corrected, curve = angles.adjust(obs.xyz[rows], certified[balls])
        xyz[rows] = corrected
        curves.append((len(poses), curve))
    adjusted = replace(obs, xyz=xyz)
    moved = np.sqrt(np.mean(np.sum((xyz - obs.xyz) ** 2, axis=1)))
    largest = max(curves, key=lambda c: c[0])[1] if curves else None
    stage = {"stage": "angle adjustment (Eq. 8-12)", "rms_correction_mm": float(moved), "rms_shape_before_mm": shape_error(obs),
             "rms_shape_after_mm": shape_error(adjusted)}
    if largest is not None:
        stage["l_curve"] = {"ridge": largest.ridge.tolist(), "misfit_rad": largest.misfit.tolist(), "size_mm": largest.size.tolist(),
                            "corner": largest.corner}
    return adjusted, [stage]


def shape_error(obs: Observations) -> float:
    """rms (mm) of measured minus certified distances between the balls of each scan."""
    same = []
    for p in range(obs.n_poses):
        rows = np.flatnonzero(obs.pose == p)
        i, j = np.triu_indices(len(rows), 1)
        same.append(np.linalg.norm(obs.xyz[rows[i]] - obs.xyz[rows[j]], axis=1)
                    - np.linalg.norm(obs.cell.ball_centres[obs.ball[rows[i]]] - obs.cell.ball_centres[obs.ball[rows[j]]], axis=1))
    errors = np.concatenate(same)
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")


def preliminary(obs: Observations) -> tuple[np.ndarray, list[dict]]:
    """T_flange_scanner (4, 4) from the phases 'translation' and 'orientation' by a virtual point; without them, from points that
    stand still."""
    phases = set() if obs.phase is None else set(obs.phase.tolist())
    if not {"translation", "orientation"} <= phases:
        found = hand_eye_from_fixed_points(obs, obs.cell.robot.chain.flange(obs.q), obs.cell.T_flange_scanner)
        X = obs.cell.T_flange_scanner if found is None else found
        return X, [{"stage": "hand-eye from fixed points (no translation and orientation phases recorded)",
                    "rms_virtual_point_mm": point_spread(obs, X)}]
    T, virtual = virtual_point(obs, obs.phase == "translation")
    R = hand_eye.rotation_from_translations(T, virtual)
    T_turned, virtual_turned = virtual_point(obs, obs.phase == "orientation")
    t = hand_eye.translation_from_orientations(T_turned, virtual_turned, R)
    X = se3.transform(R, t)
    guess = obs.cell.T_flange_scanner
    turned = se3.rotation_log(guess[:3, :3].T @ R)
    return X, [{"stage": "hand-eye rotation from translations (Eq. 7)", "poses": len(T),
                "change_deg": float(np.degrees(np.linalg.norm(turned)))},
               {"stage": "hand-eye translation from orientations", "poses": len(T_turned),
                "change_mm": float(np.linalg.norm(t - guess[:3, 3])),
                "rms_virtual_point_before_mm": _spread(T_turned @ guess, virtual_turned),
                "rms_virtual_point_after_mm": _spread(T_turned @ X, virtual_turned)}]


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
    return obs.cell.robot.chain.flange(chosen.q[whole]), hand_eye.virtual_points(points)


def point_spread(obs: Observations, X: np.ndarray) -> float:
    """rms (mm) of the balls about their mean places in the base, with the nominal arm."""
    base = se3.apply((obs.cell.robot.chain.flange(obs.q) @ X)[obs.pose], obs.xyz)
    _, group = np.unique(obs.station[obs.pose] * len(obs.cell.ball_ids) + obs.ball, return_inverse=True)
    mean = np.stack([np.bincount(group, base[:, j]) for j in range(3)], axis=1) / np.bincount(group)[:, None]
    return float(np.sqrt(np.mean(np.sum((base - mean[group]) ** 2, axis=1))))


def _spread(T: np.ndarray, virtual: np.ndarray) -> float:
    base = se3.apply(T, virtual)
    return float(np.sqrt(np.mean(np.sum((base - base.mean(axis=0)) ** 2, axis=1))))


def published_layout(obs: Observations, options: Options) -> Layout:
    """Free as in the paper's Table 1: everything but d before a parallel axis, and beta only there."""
    layout = blocks.build(obs, replace(options, balls=False, terms=()))
    parallel = obs.cell.robot.chain.parallel_next()
    free = np.ones((obs.cell.robot.n, 5), bool)
    free[parallel, 1] = False
    free[~parallel, 4] = False
    block = layout.blocks[0]
    kept = {name: why for name, why in block.why.items() if not free.reshape(-1)[block.names.index(name)]}
    kept |= {name: "not in the paper's model" for name, f in zip(block.names, free.reshape(-1), strict=True) if not f and name not in kept}
    return Layout((Block(block.name, block.names, block.units, free.reshape(-1), block.sigma, block.scale, kept), *layout.blocks[1:]))


def _as_calibration(obs, options, layout, state, first, found, stages) -> Calibration:
    lineariser = Lineariser(obs, layout, replace(options, terms=()))
    _, residual = lineariser.residual(Estimate(state))
    rank = int(np.linalg.matrix_rank(found.covariance, hermitian=True)) + 6 * len(lineariser.rows.stations)
    # The method has no noise model: what is left over is its noise, all of it ascribed to the scanner.
    share = max(residual.size - rank, 1) / residual.size
    noise = Noise(np.sqrt(np.mean(residual**2, axis=0) / share), np.zeros(obs.cell.robot.n))
    whitened = residual / noise.row_sigma(3)
    weights = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
    return Calibration(obs, options, layout, state, first, (), found.covariance, np.zeros((len(obs.cell.stations), 6, 6)), noise, weights,
                       residual, whitened, float(np.sum(whitened**2)), whitened.size - rank, rank, found.iterations,
                       extra={"stages": stages})
