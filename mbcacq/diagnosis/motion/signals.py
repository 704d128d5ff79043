"""Recorded trajectories on an equidistant clock, with rates and the torque of the rigid-body simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from mbcacq.effects.motion.effect import ChannelGroup, MotionSignals
from mbcacq.errors import ConfigError
from mbcacq.geometry.dynamics import inertial_sigma, nominal_parameters, regressor

WINDOW_S = 0.09  # of the local quintic that gives rates: short against any motion, long against the clock
PRESLIDING_RAD = 2e-5  # a joint's sense has turned after so much travel
STANDSTILL = 0.02  # of a joint's fastest speed: below, friction may be anything up to the stiction
HIGHEST_RATE_HZ = 500.0
FEWEST_SAMPLES = 200
EDGE_S = 0.05  # at both ends: a late channel has its past there, or its future, outside the recording


def prepare(trajectory) -> tuple[MotionSignals, np.ndarray]:
    """One recording as a Run, and the torque (T, n, n, 10) by unit inertial parameter of each link, without copies of what is not needed.

    Raises ConfigError for a recording that is too short or whose times do not rise.
    """
    time = np.asarray(trajectory.time_s, dtype=float)
    steps = np.diff(time)
    if len(time) < FEWEST_SAMPLES:
        raise ConfigError(f"a trajectory of {len(time)} samples is too short to diagnose; record at least {FEWEST_SAMPLES}")
    if not np.all(steps > 0):
        raise ConfigError(f"time_s does not rise at sample {int(np.argmin(steps)) + 1}; sort the recording and remove doubles")
    step = max(float(np.median(steps)), 1.0 / HIGHEST_RATE_HZ)
    resample = _resampler(time, step)
    robot, q = trajectory.robot, resample(trajectory.q)
    smooth, qd, qdd = (rates(q, step, d) for d in (0, 1, 2))
    torque, rigid, gravity, rigid_set = _torque(trajectory, resample), None, None, None
    q_set = resample(trajectory.q_set)
    set_rates = [None] * 3 if q_set is None else _exact_rates(q_set, step)
    parameters = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
    inertial, payload = np.zeros((len(q), robot.n, robot.n, 10)), None
    if torque is not None or (trajectory.q_joint is not None and robot.mass.any()):
        inertial = regressor(robot.chain, smooth, qd, qdd, robot.gravity)
        rigid = np.einsum("tjlk,lk->tj", inertial, parameters)
        still = np.zeros_like(q)
        gravity = np.einsum("tjlk,lk->tj", regressor(robot.chain, smooth, still, still, robot.gravity), parameters)
        payload = inertial[:, :, -1]
    if q_set is not None and robot.mass.any():
        rigid_set = np.einsum("tjlk,lk->tj", regressor(robot.chain, rates(q_set, step, 0), *set_rates[:2], robot.gravity), parameters)
    run = MotionSignals(
        step,
        q,
        qd,
        qdd,
        sense(q, step),
        smooth,
        q_set,
        *set_rates,
        resample(trajectory.q_joint),
        torque,
        rigid,
        rigid,
        gravity,
        rigid_set,
        payload,
        robot.gear_ratio,
    )
    return run, inertial


def rates(signal: np.ndarray, step: float, derivative: int) -> np.ndarray:
    """Derivative (T, n) by a local quintic (Savitzky-Golay): zero phase, and no noise of differences."""
    window = min(max(2 * int(WINDOW_S / step / 2) + 1, 7), (len(signal) - 1) // 2 * 2 - 1)
    return savgol_filter(signal, window, 5, deriv=derivative, delta=step, axis=0)


def _exact_rates(command: np.ndarray, step: float) -> list[np.ndarray]:
    """First to third derivative of a command, which has no noise; joints that were not commanded stay NaN."""
    out = [np.full(command.shape, np.nan) for _ in range(3)]
    time = step * np.arange(len(command))
    for j in np.flatnonzero(np.isfinite(command).all(axis=0)):
        spline = CubicSpline(time, command[:, j])
        for d in range(3):
            out[d][:, j] = spline(time, d + 1)
    return out


def _resampler(time: np.ndarray, step: float) -> Callable[[np.ndarray | None], np.ndarray | None]:
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    even = even[even <= time[-1] + 1e-6 * step]
    same = len(even) == len(time) and np.allclose(even, time, rtol=0, atol=1e-3 * step)

    def resample(signal: np.ndarray | None) -> np.ndarray | None:
        if signal is None:
            return None
        if same:
            return np.array(signal, dtype=float)
        out = np.full((len(even), signal.shape[1]), np.nan)
        for joint in range(signal.shape[1]):
            if np.all(np.isfinite(signal[:, joint])):
                out[:, joint] = CubicSpline(time, signal[:, joint])(even)
        return out

    return resample


def _torque(trajectory, resample) -> np.ndarray | None:
    torque = resample(trajectory.torque)
    if torque is None and trajectory.motor_torque is not None:
        robot = trajectory.robot
        torque = resample(trajectory.motor_torque) * (1.0 if robot.gear_ratio is None else np.abs(robot.gear_ratio))
    return torque


def sense(q: np.ndarray, step: float) -> np.ndarray:
    """Sense of the last motion (T, n) in -1..1, turning over a short travel (Dahl's model of presliding), kept at standstill."""
    smooth = rates(q, step, 0)
    out = np.zeros_like(q)
    for joint in range(q.shape[1]):
        share = np.exp(-np.abs(np.diff(smooth[:, joint])) / PRESLIDING_RAD)
        to = np.sign(np.diff(smooth[:, joint]))
        state, column = 0.0, [0.0]
        for a, s in zip(share.tolist(), to.tolist(), strict=True):
            state = s + (state - s) * a
            column.append(state)
        moved = np.flatnonzero(np.abs(column) > 0.5)
        if len(moved):  # before the first motion: unknown; the sense it then takes disturbs least
            column[: moved[0]] = [column[moved[0]]] * int(moved[0])
        out[:, joint] = column
    return out


def groups(runs: tuple[MotionSignals, ...], inertial: list[np.ndarray], robot) -> list[ChannelGroup]:
    """Every kind of mismatch that these recordings can show."""
    out = []
    inner = tuple(_inside(run) for run in runs)
    if all(run.torque is not None for run in runs):
        joints = _finite([run.torque for run in runs])
        if joints:
            sigma, fastest = inertial_sigma(robot), np.max([np.abs(run.qd).max(axis=0) for run in runs], axis=0)
            wanted = sigma > 0
            base = tuple(
                np.concatenate([(c * sigma)[:, joints][:, :, wanted], _rotors(run, robot, joints)], axis=2)
                for c, run in zip(inertial, runs, strict=True)
            )
            out.append(
                ChannelGroup(
                    "tau",
                    "N m",
                    joints,
                    tuple((run.torque - run.rigid)[:, joints] for run in runs),
                    tuple((_moving(run, fastest) & k)[:, joints] for run, k in zip(runs, inner, strict=True)),
                    base,
                    np.ones(base[0].shape[2]),
                    refit=False,
                    signal=tuple(run.torque[:, joints] for run in runs),
                )
            )
    for name, signal, sign in (("q_joint", "q_joint", 1.0), ("q_set", "q_set", -1.0)):
        if any(getattr(run, signal) is None for run in runs):
            continue
        joints = _finite([getattr(run, signal) for run in runs])
        if joints:
            mismatch = tuple(sign * (getattr(run, signal) - run.q)[:, joints] for run in runs)
            base = tuple(np.zeros((len(run.q), len(joints), 0)) for run in runs)
            late = name == "q_joint"  # a late set point and a late drive are one and the same
            use = tuple((k if late else np.ones_like(k))[:, joints] for k in inner)
            out.append(
                ChannelGroup(
                    name,
                    "rad",
                    joints,
                    mismatch,
                    use,
                    base,
                    np.zeros(0),
                    refit=True,
                    signal=tuple(run.q_joint[:, joints] for run in runs) if late else (),
                )
            )
    return out


def _finite(signals: list[np.ndarray]) -> tuple[int, ...]:
    return tuple(j for j in range(signals[0].shape[1]) if all(np.isfinite(s[:, j]).all() for s in signals))


def _inside(run: MotionSignals) -> np.ndarray:
    """(T, n): away from both ends of the recording."""
    out, edge = np.ones(run.q.shape, dtype=bool), int(np.ceil(EDGE_S / run.step_s))
    out[:edge] = out[len(out) - edge :] = False
    return out


def _moving(run: MotionSignals, fastest: np.ndarray) -> np.ndarray:
    """(T, n): the joint moves, well away from a reversal. fastest: (n,) rad/s of all recordings: in some a joint may stand all the time."""
    return np.abs(run.qd) > STANDSTILL * fastest


def _rotors(run: MotionSignals, robot, joints: tuple[int, ...]) -> np.ndarray:
    """(T, J, n): torque of each rotor, by as much inertia as the links behind it may have about its axis."""
    reach = np.cumsum((np.abs(robot.chain.a) + np.abs(robot.chain.d))[::-1])[::-1] * 1e-3
    behind = np.maximum(np.cumsum(np.maximum(robot.mass, 1.0)[::-1])[::-1], 1.0)
    scale = behind * np.maximum(reach, 0.1) ** 2
    return np.einsum("tj,jl->tjl", run.qdd[:, joints], np.eye(robot.n)[list(joints)] * scale)
