"""Motor currents as torques, where no torque was recorded: the torque constant is estimated from the arm's own weight and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.signals import direction_of_rotation, rates
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.model.trajectory import Trajectory


def with_torque(trajectories: list[Trajectory], learnt: int | None = None) -> list[Trajectory]:
    """The trajectories with ``torque`` (T, n) N m from ``current`` where all of them have only that, and the robot's masses are known.

    learnt: number of the trajectories, the first ones, by which the torque constants are estimated (None: all).
    """
    lacking = all(t.torque is None and t.motor_torque is None and t.current is not None for t in trajectories)
    if not lacking or not all(t.robot.mass.any() for t in trajectories):
        return trajectories
    ratio = current_per_torque(trajectories[:learnt])
    return trajectories if np.isnan(ratio).all() else [replace(t, torque=np.asarray(t.current) / ratio) for t in trajectories]


def current_per_torque(trajectories: list[Trajectory]) -> np.ndarray:
    """(n,) unit of current per N m about each joint, NaN where it cannot be determined: slope of the current over the rigid-body torque,
    fitted with friction and an offset."""
    columns = [_columns(t) for t in trajectories]
    n = trajectories[0].robot.n
    out = np.full(n, np.nan)
    for j in range(n):
        A = np.concatenate([c[:, j] for c in columns])
        y = np.concatenate([np.asarray(t.current)[:, j] for t in trajectories])
        if not np.isfinite(y).all():
            continue
        slope, std = _slope(A, y, NUMBERS.current_segment)
        if abs(slope) > NUMBERS.current_sigmas * std:
            out[j] = slope
    return out


def _slope(A: np.ndarray, y: np.ndarray, segment: int) -> tuple[float, float]:
    """Coefficient of the first column (T, k) in y, and its standard deviation from segments of so many samples (sandwich)."""
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    scaled = A / scale
    x, *_ = np.linalg.lstsq(scaled, y, rcond=1e-9)
    residual = y - scaled @ x
    scores = np.stack([scaled[i : i + segment].T @ residual[i : i + segment] for i in range(0, len(y), segment)])
    inverse = np.linalg.pinv(scaled.T @ scaled)
    std = float(np.sqrt((inverse @ scores.T @ scores @ inverse)[0, 0]))
    return float(x[0] / scale[0]), std / float(scale[0])


def _columns(t: Trajectory) -> np.ndarray:
    """(T, n, 4): rigid-body torque, direction, speed, one."""
    step = float(np.median(np.diff(t.time_s)))
    q, qd, qdd = (rates(t.q, step, d, NUMBERS.rate_window_s) for d in (0, 1, 2))
    parameters = nominal_parameters(t.robot.mass, t.robot.com, t.robot.payload_mass, t.robot.payload_com)
    rigid = np.einsum("tjlk,lk->tj", regressor(t.robot.chain, q, qd, qdd, t.robot.gravity), parameters)
    return np.stack([rigid, direction_of_rotation(t.q, step), qd, np.ones_like(qd)], axis=2)
