"""Initial guess from the data alone: hand-eye by linear least squares on points at rest, stations by rigid fits of points (Kabsch).

Every ball of a station is a fixed point of the base frame, whatever the hand-eye transform. This condition is linear in the twelve entries
of the transform once subtracting means has eliminated each point's own place, so no first guess is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mbcacq.estimation.forward_model import CellState, hand_eye_of_poses
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

LEVER_MM = 200.0  # of the points that stand for an orientation
REACH_MM = 3000.0  # of a target on the flange: where all poses have one orientation nothing else determines its place
NEAR_MM = 3.0  # a given hand-eye that brings the points together this well needs no other start


def start(obs: Observations) -> CellState:
    """Nominal arm, with the better of the given hand-eye and the one found from the data; robust to gross outliers."""
    chain = obs.cell.robot.chain
    T_base_flange = chain.flange(obs.q)
    if obs.cell.length_scale:
        return _multilateration(obs, T_base_flange)
    best, least = obs.cell.T_flange_scanner, np.inf
    stations = np.zeros(0)
    for X, known in hand_eye_candidates(obs, T_base_flange):
        placed, misfit = place_stations(obs, T_base_flange, X, known)
        if misfit < least:
            best, stations, least = X, placed, misfit
        if least <= NEAR_MM:
            break
    return CellState(chain, best, stations, obs.cell.ball_centres.copy())


def _multilateration(obs: Observations, T_base_flange: np.ndarray) -> CellState:
    """Instruments in the base and the target on the flange by their distances alone, with an offset of the instrument.

    With the target at its first guess p, ``p.p - L L = 2 p.a - 2 L o + (o o - a.a)`` is linear in the place a of each instrument, its
    offset o and a constant; from there by robust least squares, the target's place included.
    """
    T, L, station = T_base_flange[obs.pose], obs.xyz[:, 0], obs.station[obs.pose]
    target, places = obs.cell.T_flange_scanner.copy(), np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    p = se3.apply(T, np.tile(target[:3, 3], (len(L), 1)))
    for s in np.unique(station):
        here = station == s
        columns = np.c_[2 * p[here], -2 * L[here], np.full(here.sum(), 1e3)]
        places[s, :3, 3] = np.linalg.lstsq(columns, np.sum(p[here] ** 2, axis=1) - L[here] ** 2, rcond=1e-6)[0][:3]
        if (known := obs.cell.stations[s].T_base_station) is not None:
            places[s] = known

    def missed(x: np.ndarray) -> np.ndarray:
        away = se3.apply(T, np.tile(x[:3], (len(L), 1))) - x[4:].reshape(-1, 3)[station]
        return np.linalg.norm(away, axis=1) + x[3] - L

    from scipy.optimize import least_squares  # 90 modules, that a run never needs

    found = least_squares(missed, np.r_[target[:3, 3], 0.0, places[:, :3, 3].ravel()], loss="soft_l1", x_scale="jac", max_nfev=200).x
    target[:3, 3], places[:, :3, 3] = found[:3], found[4:].reshape(-1, 3)
    return CellState(obs.cell.robot.chain, target, places, obs.cell.ball_centres.copy())


def hand_eye_candidates(obs: Observations, T_base_flange: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
    """The given hand-eye transform, then the one found from the data where the poses determine it; each with its stations if it comes with
    them."""
    yield obs.cell.T_flange_scanner, None
    if obs.cell.measurement == TARGET_IN_BASE:
        found = target_and_stations(obs, T_base_flange)
        if found is not None:
            yield found
    else:
        X = hand_eye_from_fixed_points(obs, T_base_flange, obs.cell.T_flange_scanner)
        if X is not None:
            yield X, None


def hand_eye_from_fixed_points(obs: Observations, T_base_flange: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
    """T_flange_scanner (4, 4), or None if the poses do not determine it; an undetermined rotation is taken from the guess."""
    pose, _, xyz = _points(obs)
    T = T_base_flange[pose]
    R, t = T[:, :3, :3], T[:, :3, 3]
    group = _groups(obs)
    group = np.concatenate([group + k * (group.max(initial=0) + 1) for k in range(len(pose) // max(len(obs.pose), 1))])
    turning = (R[:, :, :, None] * xyz[:, None, None, :]).reshape(len(R), 3, 9)
    off_origin = np.abs(xyz).max(initial=0.0) > 1e-9
    columns = np.concatenate([turning, R], axis=2) if off_origin else R
    solution = se3.least_distances(columns, -t, group)
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
    translation = se3.least_distances(R, -(t + rotated), group)
    return None if translation is None else se3.transform(rotation, translation)


def target_and_stations(obs: Observations, T_base_flange: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Target on the flange (4, 4), and instrument in the base (S, 4, 4), one station after another; None if the poses do not determine
    them."""
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
        reach = np.full(lever.shape[2], REACH_MM)
        solution = se3.least_distances(columns, T[:, :3, 3], np.zeros(len(y), int), np.r_[np.full(9, np.inf), reach])
        if solution is None:
            return None
        R_bs = se3.nearest_rotation(solution[:9].reshape(3, 3))
        places = se3.least_distances(lever, T[:, :3, 3] - y @ R_bs.T, np.zeros(len(y), int), reach)
        if places is None:
            return None
        places = places.reshape(-1, 3)
        base = se3.apply(T, places[which])
        stations[s] = se3.transform(R_bs, np.median(base - y @ R_bs.T, axis=0))
        centres, R_target = obs.cell.ball_centres[balls], obs.cell.T_flange_scanner[:3, :3]
        if obs.rotation is not None:
            R_target = se3.nearest_rotation(np.median(np.swapaxes(T[:, :3, :3], 1, 2) @ R_bs @ obs.rotation[rows], axis=0))
        elif np.linalg.matrix_rank(centres - centres.mean(axis=0), tol=1.0) > 1:
            R_target = se3.fit_rigid_transforms(centres, places, np.zeros(len(balls), int), 1)[0, :3, :3]
        targets.append(se3.transform(R_target, (places - centres @ R_target.T).mean(axis=0)))
    return targets[0], stations


def place_stations(
    obs: Observations, T_base_flange: np.ndarray, X: np.ndarray, T_base_station: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Stations (S, 4, 4) as they are ``T_base_station``; without it, given ones as given, the others by fitting the points measured there.

    Also the median distance (mm) of the centres from where the arm has them. X: (4, 4) hand-eye, or that of each pose (P, 4, 4).
    """
    cell = obs.cell
    T_base_scanner = T_base_flange @ X
    pose, known, measured = _points(obs)
    by_target = cell.measurement == TARGET_IN_BASE
    here, moving = (measured, known) if by_target else (known, measured)
    there, station = se3.apply_each(T_base_scanner, pose, moving), obs.station[pose]
    if T_base_station is None:
        T_base_station = se3.fit_rigid_transforms(here, there, station, len(cell.stations))
        for s, one in enumerate(cell.stations):
            if one.T_base_station is not None:
                T_base_station[s] = one.T_base_station
    off = se3.apply(T_base_station[station], here) - there
    return T_base_station, float(np.median(np.linalg.norm(off[: obs.n_centres], axis=1)))


def _points(obs: Observations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose (K,), place in the artefact (K, 3) and measured place (K, 3) of what was measured; an orientation counts as three points more,
    ``LEVER_MM`` along the axes of the target."""
    known = obs.cell.ball_centres[obs.ball]
    if obs.rotation is None:
        return obs.pose, known, obs.xyz
    known = np.concatenate([known, *(known + axis for axis in LEVER_MM * np.eye(3))])
    return np.tile(obs.pose, 4), known, np.concatenate([obs.xyz, *(obs.xyz + LEVER_MM * obs.rotation[:, :, k] for k in range(3))])


def _groups(obs: Observations) -> np.ndarray:
    """(M,) number of the fixed point that each centre belongs to: one per station and ball."""
    key = obs.station[obs.pose] * len(obs.cell.ball_ids) + obs.ball
    return np.unique(key, return_inverse=True)[1]


def with_all_stations(obs: Observations, state: CellState) -> CellState:
    """The state with every station placed by the points measured there; as it is where distances alone were measured."""
    if obs.cell.length_scale:
        return state
    return replace(state, T_base_station=place_stations(obs, state.chain.flange(obs.q), hand_eye_of_poses(obs, state))[0])
