"""A scan taken at a pose, brought into the base frame with the calibrated cell, and how well that is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.joint_targets import joint_targets
from mbcacq.calibration.result_io import of_flange_poses
from mbcacq.errors import ConfigError
from mbcacq.exports.mount import is_target, undetermined
from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_transforms
from mbcacq.quantities import DEGREE, in_degrees

CHUNK = 200_000
POSTURES = 24  # starts of the search for joint angles
ROUNDING = 1e-3 * DEGREE  # a controller prints that much more than its limit when it stands on it


@dataclass(frozen=True, kw_only=True)
class ScanPlacement:
    """T_base_scanner (4, 4) mm. The sigmas are (3,) mm along the base axes at the middle of the scan, k = 1. There is one of the calibrated
    parameters, one of the joints' repeatability, and one of both together; worst_mm: the largest 3D one over the scan. The base is where
    the held parameters (theta_1, d_1) put it; noise of the scanner's single points is not in it.
    """

    T_base_scanner: np.ndarray
    parameters_mm: np.ndarray
    repeatability_mm: np.ndarray
    total_mm: np.ndarray
    rms_mm: float
    worst_mm: float


def place_scan(result: Mapping[str, Any], q: np.ndarray, points: np.ndarray, *, flange: bool = False) -> tuple[np.ndarray, ScanPlacement]:
    """Points (N, 3) mm in the scanner frame, measured at joints q (n,) rad as the controller reports them -> (N, 3) float64 in the base.
    flange: q (6,) is the pose of the flange, mm and rotation vector in rad, as its controller reports it.

    Raises ConfigError for a wrong number of joints, joints outside the arm's limits (where the result has them), a damaged result, or one
    that does not say where a scanner is on the flange.
    """
    if is_target(result):
        raise ConfigError(
            "this calibration is of a target on the flange, seen by an instrument in the base: it does not say where a scanner is on the "
            "flange; give the result of a run with the scanner mounted"
        )
    if why := undetermined(result):
        raise ConfigError(f"{why}, so a scan cannot be placed; calibrate from measurements that show it")
    cell = CalibratedCell.from_dict(dict(result))
    state = cell.state
    q = np.asarray(q, dtype=float)
    if of_flange_poses(result) and not flange:
        raise ConfigError(
            "this result is of poses of a flange, which have no joints; give the pose of the flange at the exposure (--flange)"
        )
    if flange and not of_flange_poses(result):
        q = joints_at(cell, flange_transforms(q[None])[0])
    if q.shape != (state.chain.n,):
        raise ConfigError(f"the arm has {state.chain.n} axes, {q.size} joint angles were given; give one for each axis, in degrees")
    if not np.isfinite(q).all():
        raise ConfigError("a joint angle is not a finite number; give one for each axis, in degrees")
    _within_limits(result, q)
    T = cell.frames(q[None])[0, -1] @ state.T_flange_scanner
    out = np.empty((len(points), 3))
    for start in range(0, len(points), CHUNK):
        some = points[start : start + CHUNK].astype(float)
        if cell.effects:
            some = cell.corrected_points(np.broadcast_to(q, (len(some), len(q))), some)
        out[start : start + CHUNK] = some @ T[:3, :3].T + T[:3, 3]
    low, high = (out.min(axis=0), out.max(axis=0)) if len(out) else (T[:3, 3], T[:3, 3])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    points_in_base = np.concatenate([[(low + high) / 2], corners])
    known, joints = base_covariance(cell, q, points_in_base)
    total = np.sqrt(np.trace(known + joints, axis1=1, axis2=2))
    of_parameters, of_joints, of_both = (np.sqrt(np.diag(c[0])) for c in (known, joints, known + joints))
    return out, ScanPlacement(
        T_base_scanner=T,
        parameters_mm=of_parameters,
        repeatability_mm=of_joints,
        total_mm=of_both,
        rms_mm=float(total[0]),
        worst_mm=float(total.max()),
    )


def joints_at(cell: CalibratedCell, T_base_flange: np.ndarray) -> np.ndarray:
    """Joint angles (n,) rad of a nominal arm whose flange is at a pose (4, 4) mm; any of its postures puts a scan at the same place.

    Raises ConfigError for an arm whose links or effects were calibrated: the pose that its controller reports is that of nominal links, at
    a posture that the pose does not tell. Raises it for a pose out of reach.
    """
    if cell.errors.any() or cell.effects:
        raise ConfigError(
            "this result corrects the arm's links, and a pose of the flange does not tell the posture in which it was; give the joint "
            "angles at the exposure (--joints)"
        )
    low, high = np.clip(np.tile([-np.inf, np.inf], (cell.nominal.n, 1)) if cell.limits is None else cell.limits, -np.pi, np.pi).T
    starts = np.random.default_rng(0).uniform(low, high, (POSTURES, cell.nominal.n))
    found = joint_targets(cell, np.tile(T_base_flange, (POSTURES, 1, 1)), starts, cell.limits)
    if not found.reached.any():
        raise ConfigError("the arm of this result does not reach this pose of the flange; check its units and orientation")
    return found.q[int(np.argmax(found.reached))]


def _within_limits(result: Mapping[str, Any], q: np.ndarray) -> None:
    """Raise ConfigError where a joint angle is outside the limits of the arm."""
    limits = result["robot"].get("limits")
    for i, (angle, (low, high)) in enumerate(zip(q, limits or [], strict=bool(limits))):
        if not low - ROUNDING <= angle <= high + ROUNDING:
            allowed = f"{in_degrees(low):g} to {in_degrees(high):g}°"
            raise ConfigError(
                f"joint {i + 1} at {in_degrees(angle):g}° is outside its limits {allowed}; "
                "give the angles in degrees as the controller reported them at the exposure"
            )


def base_covariance(cell: CalibratedCell, q: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (P, 3, 3) mm^2 of points (P, 3) in the base, measured at q (n,): of the parameters, and of the joints' repeatability."""
    postures = np.broadcast_to(q, (len(points), len(q)))
    T = cell.state.chain.flange(q[None])[0] @ cell.state.T_flange_scanner
    known = cell.point_covariance(postures, se3.apply(se3.inverse(T), points))
    chain = cell.state.chain
    B = _moved(chain.joint_twists(chain.frames(q[None]))[0] * cell.noise.joint[:, None], points)
    return known, B @ np.swapaxes(B, 1, 2)


def _moved(twists: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 3, k): movement of each point by each spatial twist (k, 6)."""
    moved = twists[None, :, :3] + np.cross(twists[None, :, 3:], points[:, None])
    return np.swapaxes(moved, 1, 2)
