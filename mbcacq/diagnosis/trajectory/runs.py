"""Recorded trajectories on an equidistant clock, with rates and the torque of the rigid-body simulation."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from mbcacq.errors import ConfigError
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.physics.trajectory.effect import Channel, Run

WINDOW_S = 0.05        # of the local cubic that gives rates: short against any motion, long against the clock
MASS_SIGMA = 0.3       # how far public masses and centres are off, as a share
HIGHEST_RATE_HZ = 500.0
FEWEST_SAMPLES = 200


def prepare(trajectory) -> tuple[Run, list[np.ndarray]]:
    """One recording as a Run, and per joint the columns (T, b) of its inertial parameters, scaled to one prior sigma.

    Raises ConfigError for a recording that is too short or whose times do not rise.
    """
    time = np.asarray(trajectory.time_s, dtype=float)
    steps = np.diff(time)
    if len(time) < FEWEST_SAMPLES:
        raise ConfigError(f"a trajectory of {len(time)} samples is too short to diagnose; record at least {FEWEST_SAMPLES}")
    if not np.all(steps > 0):
        raise ConfigError(f"time_s does not rise at sample {int(np.argmin(steps)) + 1}; sort the recording and remove doubles")
    step = max(float(np.median(steps)), 1.0 / HIGHEST_RATE_HZ)
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    even = even[even <= time[-1]]

    def resample(signal: np.ndarray | None) -> np.ndarray | None:
        if signal is None:
            return None
        if len(even) == len(time) and np.allclose(even, time, rtol=0, atol=1e-3 * step):
            return np.array(signal, dtype=float)
        out = np.full((len(even), signal.shape[1]), np.nan)
        for joint in range(signal.shape[1]):
            if np.all(np.isfinite(signal[:, joint])):
                out[:, joint] = CubicSpline(time, signal[:, joint])(even)
        return out

    robot, q = trajectory.robot, resample(trajectory.q)
    window = min(max(2 * int(WINDOW_S / step / 2) + 1, 5), len(even) // 4 * 2 - 1)
    smooth, qd, qdd = (savgol_filter(q, window, 3, deriv=d, delta=step, axis=0) for d in (0, 1, 2))
    torque = resample(trajectory.torque)
    if torque is None and trajectory.motor_torque is not None:
        ratio = robot.gear_ratio if robot.gear_ratio is not None else np.ones(robot.n)
        torque = resample(trajectory.motor_torque) * np.abs(ratio)
    rigid = gravity = None
    inertial: list[np.ndarray] = [np.zeros((len(q), 0))] * robot.n
    if torque is not None:
        columns = regressor(robot.chain, smooth, qd, qdd, robot.gravity)
        still = regressor(robot.chain, smooth, 0 * qd, 0 * qdd, robot.gravity)
        parameters = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
        rigid = np.einsum("tjlk,lk->tj", columns, parameters)
        gravity = np.einsum("tjlk,lk->tj", still, parameters)
        inertial = _inertial_columns(robot, columns, qdd)
    run = Run(step, q, qd, qdd, q_set=resample(trajectory.q_set), q_joint=resample(trajectory.q_joint), torque=torque,
              rigid=rigid, gravity=gravity, gear_ratio=robot.gear_ratio)
    return run, inertial


def _inertial_columns(robot, columns: np.ndarray, qdd: np.ndarray) -> list[np.ndarray]:
    """Per joint (T, b): torque by one sigma of each inertial parameter of the links behind it, and of the rotor's inertia."""
    size = np.maximum(np.linalg.norm(robot.com, axis=1), 100.0) * 1e-3
    mass = np.maximum(robot.mass, 0.05 * max(robot.mass.sum(), 1.0))
    scale = MASS_SIGMA * mass[:, None] * np.stack([np.ones_like(size)] + [size] * 3 + [size**2] * 6, axis=1)
    reach = np.cumsum((np.abs(robot.chain.a) + np.abs(robot.chain.d))[::-1])[::-1] * 1e-3
    out = []
    for joint in range(robot.n):
        behind = (columns[:, joint, joint:] * scale[joint:]).reshape(len(qdd), -1)
        rotor = mass[joint:].sum() * max(reach[joint], 0.1) ** 2 * qdd[:, [joint]]
        out.append(np.concatenate([behind, rotor], axis=1))
    return out


def channels(runs: list[Run], inertial: list[list[np.ndarray]]) -> list[Channel]:
    """Every mismatch that these recordings can show, joint by joint."""
    out = []
    for joint in range(runs[0].q.shape[1]):
        offset = tuple(np.ones((len(run.q), 1)) for run in runs)
        for name, signal in (("q_joint", "q_joint"), ("q_set", "q_set")):
            if any(getattr(run, signal) is None or not np.isfinite(getattr(run, signal)[:, joint]).all() for run in runs):
                continue
            sign = 1.0 if name == "q_joint" else -1.0
            mismatch = tuple(sign * (getattr(run, signal)[:, joint] - run.q[:, joint]) for run in runs)
            out.append(Channel(name, joint, "rad", mismatch, offset, np.array([np.inf])))
        if all(run.torque is not None and np.isfinite(run.torque[:, joint]).all() for run in runs):
            mismatch = tuple(run.torque[:, joint] - run.rigid[:, joint] for run in runs)
            base = tuple(np.concatenate([one, columns[joint]], axis=1) for one, columns in zip(offset, inertial, strict=True))
            out.append(Channel("tau", joint, "N m", mismatch, base, np.concatenate([[np.inf], np.ones(base[0].shape[1] - 1)])))
    return out
