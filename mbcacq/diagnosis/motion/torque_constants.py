"""Motor currents as torques, where no torque was recorded: what a unit of current is worth is read off the arm's own weight and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.signals import rates, sense
from mbcacq.geometry.dynamics import nominal_parameters, regressor

LEAST_SIGMAS = 20.0  # a joint whose current does not show the arm's torque as clearly has no torque
PIECE = 125  # samples taken as one witness


def with_torque(trajectories: list) -> list:
    """The trajectories with ``torque`` (T, n) N m from ``current`` where all of them have only that, and the robot's masses are known."""
    lacking = all(t.torque is None and t.motor_torque is None and t.current is not None for t in trajectories)
    if not lacking or not all(t.robot.mass.any() for t in trajectories):
        return trajectories
    worth = current_per_torque(trajectories)
    return trajectories if np.isnan(worth).all() else [replace(t, torque=np.asarray(t.current) / worth) for t in trajectories]


def current_per_torque(trajectories: list) -> np.ndarray:
    """(n,) unit of current per N m about each joint, NaN where it cannot be told: slope of the current over the rigid-body torque, friction
    and offset beside it."""
    parts = [_columns(t) for t in trajectories]
    n = trajectories[0].robot.n
    out = np.full(n, np.nan)
    for j in range(n):
        A = np.concatenate([p[:, j] for p in parts])
        y = np.concatenate([np.asarray(t.current)[:, j] for t in trajectories])
        if not np.isfinite(y).all():
            continue
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x, *_ = np.linalg.lstsq(A / scale, y, rcond=1e-9)
        left = y - (A / scale) @ x
        scores = np.stack([(A[i : i + PIECE] / scale).T @ left[i : i + PIECE] for i in range(0, len(y), PIECE)])
        inverse = np.linalg.pinv((A / scale).T @ (A / scale))
        std = float(np.sqrt((inverse @ scores.T @ scores @ inverse)[0, 0]))
        if abs(x[0]) > LEAST_SIGMAS * std:
            out[j] = x[0] / scale[0]
    return out


def _columns(t) -> np.ndarray:
    """(T, n, 4): rigid-body torque, sense, speed, one."""
    step = float(np.median(np.diff(t.time_s)))
    q, qd, qdd = (rates(t.q, step, d) for d in (0, 1, 2))
    parameters = nominal_parameters(t.robot.mass, t.robot.com, t.robot.payload_mass, t.robot.payload_com)
    rigid = np.einsum("tjlk,lk->tj", regressor(t.robot.chain, q, qd, qdd, t.robot.gravity), parameters)
    return np.stack([rigid, sense(t.q, step), qd, np.ones_like(qd)], axis=2)
