"""A motion carried out and recorded: what the controller and its encoders would write, each channel by its own clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from mbcacq_fakes.dynamics.arm import Links
from mbcacq_fakes.dynamics.bodies import Bodies
from mbcacq_fakes.dynamics.faults import Drives, FaultScale, inject_faults, together

CYCLE_S = 0.004
FINER = 8  # steps of a drive's lag in one of the arm's
MARGIN_S = 0.1  # recorded before and after, for clocks that are late
INERTIA = 0.02  # masses and centres differ from the description by so much


@dataclass(frozen=True)
class SignalNoise:
    """One sigma: encoder of the motor, of the joint side (rad), torque as a share of that of a typical motion."""

    motor_rad: float = 3e-7
    joint_rad: float = 2e-6
    torque: float = 0.005


@dataclass(frozen=True)
class RecordedMotion:
    """Channels (T, n): rad, Nm. truth: every injected fault with name, where, parameters."""

    time_s: np.ndarray
    q_set: np.ndarray
    q: np.ndarray
    q_joint: np.ndarray
    torque: np.ndarray
    truth: list[dict[str, Any]]


def recorded(
    robot: Any,
    injected: Sequence[Mapping[str, Any]],
    seed: int,
    motion: int = 0,
    seconds: float = 12.0,
    speed_share: float = 0.5,
    noise: SignalNoise | None = None,
    planned: tuple[np.ndarray, np.ndarray] | None = None,
) -> RecordedMotion:
    """Robot: an mbcacq RobotModel (duck-typed). injected: ``{name, where?, strength?, ...}``; seed: the arm, motion: which motion of it.

    speed_share: share of the joints' speed limits that is reached. planned: times (T,) s and set points (T, n) rad to follow in place of a
    motion drawn at random. Raises ConfigError for an unknown fault.
    """
    noise = noise or SignalNoise()
    rng = np.random.default_rng([seed, 17])
    mass = np.asarray(robot.mass) * (1 + INERTIA * rng.standard_normal(robot.n))
    com = np.asarray(robot.com) * (1 + INERTIA * rng.standard_normal((robot.n, 3)))
    speed = np.radians(150.0) * np.ones(robot.n) if robot.speed is None else np.asarray(robot.speed)
    described = (float(robot.payload_mass), np.asarray(robot.payload_com, dtype=float))
    drives = Drives(robot.n, declared=described)
    typical = FaultScale(typical_torque(robot, speed_share * speed), speed_share * speed, 1.0, rng)
    truth = inject_faults(drives, injected, typical)
    bodies = Bodies(robot.chain.sign, robot.chain.rows, mass, com, together(described, drives.payload), robot.gravity)
    if planned is None:
        time, command = fourier(robot, seconds, speed_share * speed, np.random.default_rng([seed, 18, motion]))
    else:
        time = np.arange(planned[0][0], planned[0][-1], CYCLE_S)
        command = CubicSpline(*planned)
    fine = simulate(bodies, drives, time, command)
    noise_rng = np.random.default_rng([seed, 19, motion])
    at = {name: time - drives.clocks.get(name, 0.0) for name in ("q_joint", "tau", "q_set")}
    q = _read(fine["time"], fine["motor"], time) + noise.motor_rad * noise_rng.standard_normal((len(time), robot.n))
    q_joint = _read(fine["time"], fine["joint"], at["q_joint"]) + noise.joint_rad * noise_rng.standard_normal(q.shape)
    torque = _read(fine["time"], fine["torque"], at["tau"]) + noise.torque * typical.torque * noise_rng.standard_normal(q.shape)
    return RecordedMotion(time, command(at["q_set"]), q, q_joint, torque, truth)


def simulate(bodies: Bodies, drives: Drives, time: np.ndarray, command) -> dict[str, np.ndarray]:
    """Step the arm along a command (a spline of time). Returns its history on a fine clock: time, motor, joint, torque, gear."""
    start = command(time[0])
    links = Links(bodies, drives, start.copy())
    pieces = max(int(np.ceil(CYCLE_S / 2 / links.substep_s())), 1) if np.isfinite(links.substep_s()) else 1
    dt = CYCLE_S / 2 / pieces
    clock = np.arange(time[0] - MARGIN_S, time[-1] + MARGIN_S, dt)
    motor, speed, acceleration = follow(drives, clock, time, command)
    keep = np.arange(0, len(clock), pieces)
    out = {name: np.empty((len(keep), bodies.n)) for name in ("joint", "torque", "gear")}
    row = 0
    for k in range(len(clock)):
        torque, gear = links.step(motor[k], speed[k], acceleration[k], dt)
        if k % pieces == 0:
            out["torque"][row], out["gear"][row], out["joint"][row] = torque, gear, links.encoder(motor[k])
            row += 1
    return {"time": clock[keep], "motor": motor[keep], **out}


def follow(drives: Drives, clock: np.ndarray, time: np.ndarray, command) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motor side (T, n): the command after each drive's dead time and first-order lag, with rate and acceleration."""
    n, dt = drives.n, float(clock[1] - clock[0])
    out = [np.empty((len(clock), n)) for _ in range(3)]
    for j in range(n):
        lag, finer = drives.time_constant_s[j], FINER if drives.time_constant_s[j] > 0 else 1
        fine = clock[0] + dt / finer * np.arange((len(clock) - 1) * finer + 1)
        late = np.clip(fine - drives.latency_s[j], time[0], time[-1])
        outside = late != fine - drives.latency_s[j]
        values = [command(late, nu)[:, j] for nu in (0, 1, 2)]
        values[1][outside] = values[2][outside] = 0.0
        if lag > 0:
            ratio = dt / finer / lag
            keep, gone = np.exp(-ratio), -np.expm1(-ratio)
            first = values[0][0]  # exact for a command that is a ramp between two samples
            followed = first + lfilter([1 - gone / ratio, gone / ratio - keep], [1.0, -keep], values[0] - first)
            rate = (values[0] - followed) / lag
            values = [followed, rate, (values[1] - rate) / lag]
        values = [v[::finer] for v in values]
        for o, v in zip(out, values, strict=True):
            o[:, j] = v
    return out[0], out[1], out[2]


def fourier(robot: Any, seconds: float, speed: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, CubicSpline]:
    """Set points every cycle of a motion that begins and ends at rest: five harmonics a joint, within limits and speed (n,) rad/s."""
    time = np.arange(0, seconds, CYCLE_S)
    ramp = np.clip(np.minimum(time - 0.3, seconds - 0.3 - time) / 1.5, 0, 1)
    ramp = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
    low, high = np.asarray(robot.limits).T
    home = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])[: robot.n] + rng.uniform(-0.25, 0.25, robot.n)
    home[-2] += 0.4
    home = np.clip(home, low + 0.4, high - 0.4)
    q = np.empty((len(time), robot.n))
    for j in range(robot.n):
        k = np.arange(1, 6)[:, None] * (10.0 / seconds if seconds > 20 else 1.0)
        wave = (rng.normal(size=(5, 1)) / k * np.sin(2 * np.pi * k * time / min(seconds, 10.0) + rng.uniform(0, 6.28, (5, 1)))).sum(0)
        wave = ramp * (wave - wave.mean())
        reach = 0.9 * min(high[j] - home[j], home[j] - low[j], np.radians(70.0)) / np.abs(wave).max()
        fast = speed[j] / np.abs(np.gradient(wave, CYCLE_S)).max()
        q[:, j] = home[j] + min(reach, fast) * wave
    return time, CubicSpline(time, q)


def _read(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    return CubicSpline(time, values)(at)


def typical_torque(robot: Any, speed: np.ndarray) -> np.ndarray:
    """Typical torque (n,) Nm: weight held out and speed reached in a third of a second."""
    reach = np.cumsum((np.abs(robot.chain.a) + np.abs(robot.chain.d))[::-1])[::-1] * 1e-3
    behind = np.cumsum(np.asarray(robot.mass)[::-1])[::-1] + 1.0
    torque = 0.25 * behind * np.maximum(reach, 0.1) * (9.81 * np.minimum(reach / 0.5, 1) + np.maximum(reach, 0.1) * speed / 0.33)
    return np.maximum(torque, 6.0)
