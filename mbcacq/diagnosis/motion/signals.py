"""Recorded trajectories at equidistant times, with rates and the torque of the rigid-body simulation.

Motor currents stand for a torque that was not recorded: the torque constant is estimated from the arm's own weight and inertia.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.errors import ConfigError
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory

Resample = Callable[[np.ndarray], np.ndarray]


def prepare(trajectory: Trajectory) -> tuple[MotionSignals, np.ndarray]:
    """The signals of one recording, and the torque (T, n, n, 10) by unit inertial parameter of each link.

    Raises ConfigError for a recording that is too short or whose times do not rise.
    """
    time, step = _times(trajectory)
    resample = _resampler(time, step)
    robot, q = trajectory.robot, resample(trajectory.q)
    smooth, qd, qdd = (rates(q, step, d, NUMBERS.rate_window_s) for d in (0, 1, 2))
    torque, q_joint = _torque(trajectory, resample), _optional(trajectory.q_joint, resample)
    inertial = np.zeros((len(q), robot.n, robot.n, 10))
    rigid, gravity, payload = None, None, None
    if torque is not None or (q_joint is not None and robot.mass.any()):
        inertial = regressor(robot.chain, smooth, qd, qdd, robot.gravity)
        rigid = _rigid(inertial, robot) if trajectory.simulated_torque is None else resample(trajectory.simulated_torque)
        still = np.zeros_like(q)
        gravity = _rigid(regressor(robot.chain, smooth, still, still, robot.gravity), robot)
        payload = inertial[:, :, -1]
    q_set, rigid_set = _optional(trajectory.q_set, resample), None
    qd_set, qdd_set, qddd_set = (None, None, None) if q_set is None else _exact_rates(q_set, step)
    if q_set is not None and qd_set is not None and qdd_set is not None and robot.mass.any():
        smooth_set = rates(q_set, step, 0, NUMBERS.rate_window_s)
        rigid_set = _rigid(regressor(robot.chain, smooth_set, qd_set, qdd_set, robot.gravity), robot)
    run = MotionSignals(step, q, qd, qdd, direction_of_rotation(q, step), smooth, q_set, qd_set=qd_set, qdd_set=qdd_set, qddd_set=qddd_set)
    run = replace(run, torque=torque, load=rigid, rigid=rigid, gravity=gravity, rigid_set=rigid_set, payload=payload)
    return replace(run, q_joint=q_joint, gear_ratio=robot.gear_ratio, robot=robot), inertial


def rates(signal: np.ndarray, step: float, derivative: int, window_s: float) -> np.ndarray:
    """Derivative (T, n) by a local quintic (Savitzky-Golay): zero phase, and no noise of differences."""
    window = min(max(2 * int(window_s / step / 2) + 1, 7), (len(signal) - 1) // 2 * 2 - 1)
    return np.asarray(savgol_filter(signal, window, 5, deriv=derivative, delta=step, axis=0))


def direction_of_rotation(q: np.ndarray, step: float) -> np.ndarray:
    """Direction of the last motion (T, n) in -1..1, which changes over a short travel (Dahl's model of presliding) and stays at
    standstill."""
    smooth = rates(q, step, 0, NUMBERS.rate_window_s)
    out = np.zeros_like(q)
    for joint in range(q.shape[1]):
        travel = np.diff(smooth[:, joint])
        keep, target = np.exp(-np.abs(travel) / NUMBERS.presliding_rad), np.sign(travel)
        state, column = 0.0, [0.0]
        for a, s in zip(keep.tolist(), target.tolist(), strict=True):
            state = s + (state - s) * a
            column.append(state)
        moved = np.flatnonzero(np.abs(column) > 0.5)
        if len(moved):  # before the first motion it is unknown; that of the first motion disturbs least
            column[: moved[0]] = [column[moved[0]]] * int(moved[0])
        out[:, joint] = column
    return out


def _times(trajectory: Trajectory) -> tuple[np.ndarray, float]:
    """Recorded times (T,) and the step to resample them to."""
    time = np.asarray(trajectory.time_s, dtype=float)
    steps = np.diff(time)
    fewest = NUMBERS.fewest_samples
    if len(time) < fewest:
        raise ConfigError(f"a trajectory of {len(time)} samples is too short to diagnose; record at least {fewest}")
    if not np.all(steps > 0):
        sample = int(np.argmin(steps)) + 1
        raise ConfigError(f"time_s does not rise at sample {sample}; sort the recording and remove doubles")
    return time, max(float(np.median(steps)), 1.0 / NUMBERS.highest_rate_hz)


def _exact_rates(command: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First to third derivative of a command, which has no noise; joints that were not commanded stay NaN."""
    first, second, third = (np.full(command.shape, np.nan) for _ in range(3))
    time = step * np.arange(len(command))
    for j in np.flatnonzero(np.isfinite(command).all(axis=0)):
        spline = CubicSpline(time, command[:, j])
        for out, derivative in ((first, 1), (second, 2), (third, 3)):
            out[:, j] = spline(time, derivative)
    return first, second, third


def _resampler(time: np.ndarray, step: float) -> Resample:
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    even = even[even <= time[-1] + 1e-6 * step]
    same = len(even) == len(time) and np.allclose(even, time, rtol=0, atol=1e-3 * step)

    def resample(signal: np.ndarray) -> np.ndarray:
        if same:
            return np.array(signal, dtype=float)
        out = np.full((len(even), signal.shape[1]), np.nan)
        for joint in range(signal.shape[1]):
            if np.all(np.isfinite(signal[:, joint])):
                out[:, joint] = CubicSpline(time, signal[:, joint])(even)
        return out

    return resample


def _optional(signal: np.ndarray | None, resample: Resample) -> np.ndarray | None:
    return None if signal is None else resample(signal)


def _torque(trajectory: Trajectory, resample: Resample) -> np.ndarray | None:
    """Torque of the drives at the joints, recorded there or at the motors."""
    if trajectory.torque is not None or trajectory.motor_torque is None:
        return _optional(trajectory.torque, resample)
    ratio = trajectory.robot.gear_ratio
    return resample(trajectory.motor_torque) * (1.0 if ratio is None else np.abs(ratio))


def _rigid(inertial: np.ndarray, robot: RobotModel) -> np.ndarray:
    """(T, n) torque of the rigid arm as it is described."""
    return np.einsum("tjlk,lk->tj", inertial, nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com))


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
