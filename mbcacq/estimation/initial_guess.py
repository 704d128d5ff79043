"""Initial guess from the data alone: hand-eye by linear least squares on points at rest, stations by rigid fits of points (Kabsch).

Every ball of a station is a fixed point of the base frame, whatever the hand-eye transform. That is linear in the twelve
entries of the transform once each point's own place is eliminated by subtracting means; so no first guess is needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.estimation.forward_model import CellState, hand_eye_of_poses
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

ROUNDS = 6
ALIKE = 10.0  # times the median distance: without an outlier beyond it, other weights would change little
LEVER_MM = 200.0  # of the points that stand for an orientation
NEAR_MM = 3.0  # a given hand-eye that brings the points together this well needs no other start


def start(obs: Observations, chain: Chain | None = None) -> CellState:
    """Nominal arm (or ``chain``), with the better of the given hand-eye and the one found from the data; robust to gross outliers."""
    chain = obs.cell.robot.chain if chain is None else chain
    T_base_flange = chain.flange(obs.q)
    guess = obs.cell.T_flange_scanner
    given = guess, place_stations(obs, T_base_flange, guess)
    spread = misfit(obs, T_base_flange, *given)
    if spread > NEAR_MM:
        if obs.cell.measurement == TARGET_IN_BASE:
            found = tracker_start(obs, T_base_flange)
        else:
            X = hand_eye_from_fixed_points(obs, T_base_flange, guess)
            found = None if X is None else (X, place_stations(obs, T_base_flange, X))
        if found is not None and misfit(obs, T_base_flange, *found) < spread:
            given = found
    return CellState(chain, *given, obs.cell.ball_centres.copy())


def hand_eye_from_fixed_points(obs: Observations, T_base_flange: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
    """T_flange_scanner (4, 4), or None where the poses do not determine it; an undetermined rotation is taken from the guess."""
    pose, _, xyz = _points(obs)
    T = T_base_flange[pose]
    R, t = T[:, :3, :3], T[:, :3, 3]
    group = _groups(obs)
    group = np.concatenate([group + k * (group.max(initial=0) + 1) for k in range(len(pose) // max(len(obs.pose), 1))])
    turning = (R[:, :, :, None] * xyz[:, None, None, :]).reshape(len(R), 3, 9)
    off_origin = np.abs(xyz).max(initial=0.0) > 1e-9
    columns = np.concatenate([turning, R], axis=2) if off_origin else R
    solution = _linear_l1(columns, -t, group)
    if solution is None and not off_origin:
        return None
    if solution is not None and off_origin:
        rotation = solution[:9].reshape(3, 3)
        size = np.linalg.svd(rotation, compute_uv=False)
        if size[-1] < 0.5 or size[0] > 2.0:
            return None
        rotation = se3.nearest_rotation(rotation)
    else:
        rotation = guess[:3, :3]
    rotated = np.einsum("mij,jk,mk->mi", R, rotation, xyz)
    translation = _linear_l1(R, -(t + rotated), group)
    return None if translation is None else se3.transform(rotation, translation)


def tracker_start(obs: Observations, T_base_flange: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Target on the flange (4, 4) and instrument in the base (S, 4, 4), one station after another; None where not determined."""
    stations = np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    targets = []
    for s in np.unique(obs.station):
        rows = obs.station[obs.pose] == s
        T = T_base_flange[obs.pose[rows]]
        y = obs.xyz[rows]
        # R_bs y + t_bs - R p_b = t_flange, linear in R_bs (9) and, centred, in the reflectors' places p_b on the flange (3 each).
        balls, which = np.unique(obs.ball[rows], return_inverse=True)
        lever = (-T[:, :3, None, :3] * (which[:, None] == np.arange(len(balls)))[:, None, :, None]).reshape(len(y), 3, -1)
        columns = np.concatenate([np.kron(np.eye(3), y[:, None, :]).reshape(-1, 3, 9), lever], axis=2)
        solution = _linear_l1(columns, T[:, :3, 3], np.zeros(len(y), int))
        if solution is None:
            return None
        R_bs = se3.nearest_rotation(solution[:9].reshape(3, 3))
        places = _linear_l1(lever, T[:, :3, 3] - y @ R_bs.T, np.zeros(len(y), int))
        if places is None:
            return None
        places = places.reshape(-1, 3)
        base = se3.apply(T, places[which])
        stations[s] = se3.transform(R_bs, np.median(base - y @ R_bs.T, axis=0))
        centres, R_target = obs.cell.ball_centres[balls], obs.cell.T_flange_scanner[:3, :3]
        if obs.rotation is not None:
            R_target = se3.nearest_rotation(np.median(np.swapaxes(T[:, :3, :3], 1, 2) @ R_bs @ obs.rotation[rows], axis=0))
        elif np.linalg.matrix_rank(centres - centres.mean(axis=0), tol=1.0) > 1:
            R_target = fit_rigid_transforms(centres, places, np.zeros(len(balls), int), 1)[0, :3, :3]
        targets.append(se3.transform(R_target, (places - centres @ R_target.T).mean(axis=0)))
    return targets[0], stations


def place_stations(obs: Observations, T_base_flange: np.ndarray, X: np.ndarray) -> np.ndarray:
    """T_base_station (S, 4, 4): given ones as given, the others by fitting the points measured there."""
    cell = obs.cell
    T_base_scanner = T_base_flange @ X
    pose, known, measured = _points(obs)
    if cell.measurement == TARGET_IN_BASE:
        here, there = measured, se3.apply_each(T_base_scanner, pose, known)
    else:
        here, there = known, se3.apply_each(T_base_scanner, pose, measured)
    out = fit_rigid_transforms(here, there, obs.station[pose], len(cell.stations))
    for s, station in enumerate(cell.stations):
        if station.T_base_station is not None:
            out[s] = station.T_base_station
    return out


def _points(obs: Observations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose (K,), place in the artefact (K, 3) and measured place (K, 3) of what was measured; an orientation counts as three points more,
    ``LEVER_MM`` along the axes of the target."""
    known = obs.cell.ball_centres[obs.ball]
    if obs.rotation is None:
        return obs.pose, known, obs.xyz
    known = np.concatenate([known, *(known + axis for axis in LEVER_MM * np.eye(3))])
    return np.tile(obs.pose, 4), known, np.concatenate([obs.xyz, *(obs.xyz + LEVER_MM * obs.rotation[:, :, k] for k in range(3))])


def fit_rigid_transforms(a: np.ndarray, b: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Rigid transforms (count, 4, 4) that bring the points a (M, 3) of each group onto b (Kabsch), reweighted against outliers."""
    R, ca, cb = _kabsch(a, b, np.ones(len(a)), group, count)
    for _ in range(ROUNDS - 1):
        off = np.linalg.norm(b - cb[group] - np.einsum("mij,mj->mi", R[group], a - ca[group]), axis=1)
        if off.max(initial=0.0) < ALIKE * np.median(off):
            break
        R, ca, cb = _kabsch(a, b, 1.0 / np.maximum(off, 0.5 * np.median(off) + 1e-9), group, count)
    return se3.transform(R, cb - np.einsum("sij,sj->si", R, ca))


def _kabsch(a: np.ndarray, b: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted best rotations (count, 3, 3) of a (M, 3) onto b (M, 3) by group (Kabsch 1976), and both weighted means (count, 3)."""
    ca, cb = _means(a, weight, group, count), _means(b, weight, group, count)
    da, db = a - np.take(ca, group, axis=0), b - np.take(cb, group, axis=0)
    product = np.einsum("mi,mj->mij", db, weight[:, None] * da).reshape(-1, 9)
    return se3.nearest_rotation(_sums(product, group, count).reshape(-1, 3, 3)), ca, cb


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, k) of values (M, k) by group."""
    k = values.shape[1]
    return np.bincount((group[:, None] * k + np.arange(k)).ravel(), values.ravel(), count * k).reshape(count, k)


def _means(values: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Weighted means (count, k); zero for an empty group."""
    total = np.bincount(group, weight, count)
    return _sums(values * weight[:, None], group, count) / np.where(total > 0, total, 1.0)[:, None]


def misfit(obs: Observations, T_base_flange: np.ndarray, X: np.ndarray, stations: np.ndarray) -> float:
    """Median distance (mm) between where the points are and where they ought to be."""
    T_base_scanner = T_base_flange @ X
    T_station = stations[obs.station[obs.pose]]
    if obs.cell.measurement == TARGET_IN_BASE:
        off = se3.apply(T_station, obs.xyz) - se3.apply_each(T_base_scanner, obs.pose, obs.cell.ball_centres[obs.ball])
    else:
        off = se3.apply_each(T_base_scanner, obs.pose, obs.xyz) - se3.apply(T_station, obs.cell.ball_centres[obs.ball])
    return float(np.median(np.linalg.norm(off, axis=1)))


def _groups(obs: Observations) -> np.ndarray:
    """(M,) number of the fixed point that each centre belongs to: one per station and ball."""
    key = obs.station[obs.pose] * len(obs.cell.ball_ids) + obs.ball
    return np.unique(key, return_inverse=True)[1]


def _linear_l1(columns: np.ndarray, target: np.ndarray, group: np.ndarray) -> np.ndarray | None:
    """x that minimises the sum of lengths of ``columns x - target`` (M, 3), each group about a free mean; None where undetermined."""
    count = group.max(initial=0) + 1
    weight = np.ones(len(columns))
    x = None
    for _ in range(ROUNDS):
        A, b = _centred(columns, weight, group, count), _centred(target, weight, group, count)
        flat = (A * weight[:, None, None]).reshape(-1, A.shape[2])
        normal = flat.T @ A.reshape(-1, A.shape[2])
        scale = np.sqrt(np.diag(normal))
        if not np.all(scale > 0):
            return None
        scaled = normal / scale[:, None] / scale
        if np.linalg.eigvalsh(scaled)[0] < 1e-7:
            return None
        x = np.linalg.solve(scaled, flat.T @ b.reshape(-1) / scale) / scale
        off = np.linalg.norm(A @ x - b, axis=1)
        weight = 1.0 / np.maximum(off, 0.2 * np.median(off) + 1e-9)
    return x


def _centred(values: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """values (M, ...) less the weighted mean of their group."""
    flat = values.reshape(len(values), -1)
    return (flat - _means(flat, weight, group, count)[group]).reshape(values.shape)


def with_all_stations(obs: Observations, state: CellState) -> CellState:
    """The state with every station placed by the points measured there."""
    placed = place_stations(obs, state.chain.flange(obs.q), hand_eye_of_poses(obs, state))
    return replace(state, T_base_station=placed)
