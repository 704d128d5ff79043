"""Simulated sweeps of a line profiler over a sphere: cycles of the controller, and profiles with times of a clock of their own."""

from dataclasses import dataclass

import numpy as np
from hand_eye_data import frame

from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_coordinates

RADIUS = 15.0
VIEW = np.radians(60.0)
REST_S = 0.15
RAMP_S = 0.1


def _ramp(x):
    """Way after x (s) of a speed that rises to 1 as a raised cosine."""
    x = np.clip(x, 0, RAMP_S)
    return x / 2 - RAMP_S / (2 * np.pi) * np.sin(np.pi * x / RAMP_S)


@dataclass(frozen=True)
class Sweeps:
    """cycle_s (N,) and reported poses (N, 4, 4) by the controller's clock; profile_s (P,) by the sensor's, points of each profile."""

    cycle_s: np.ndarray
    reported: np.ndarray
    profile_s: np.ndarray
    points: list
    T_hand_eye: np.ndarray
    sphere: np.ndarray
    delay_s: float
    epoch_s: float
    numbers: np.ndarray


def sweeps(
    rng,
    *,
    speed=100.0,
    rate_hz=100.0,
    delay=0.0173,
    jitter=0.0,
    drift=0.0,
    lost=0.0,
    lines=8,
    pose_sigma=0.01,
    noise=0.02,
    cycle=0.004,
    there_and_back=True,
):
    """Lines across the sphere, each with an orientation and a direction of its own, each run forth and (``there_and_back``) back."""
    X, sphere = frame(rng, 20.0, [30.0, -10, 120], 0.3), np.array([650.0, 20, 90])
    moves, t = [], 0.3
    for _ in range(lines):
        R = se3.rotation_exp(0.45 * rng.normal(size=3)) @ np.diag([1.0, -1, -1])
        s = np.array([rng.uniform(-15, 15), 0.0, 300 + rng.uniform(-20, 20)])
        middle = sphere - R @ (X[:3, :3] @ s + X[:3, 3])
        along = R @ X[:3, :3] @ np.array([0.3 * rng.normal(), 1.0, 0.1 * rng.normal()])
        along /= np.linalg.norm(along)
        turn = 0.05 * rng.normal(size=3)
        length = 2.0 * RADIUS * 1.3 + speed * RAMP_S
        for way in (1.0, -1.0) if there_and_back else (1.0, 1.0):
            duration = length / speed + RAMP_S
            moves.append((t, t + duration, R, middle, way * along, length, way * turn))
            t += duration + REST_S
    end = t

    def at(times):
        out = np.empty((len(times), 4, 4))
        for i, now in enumerate(times):
            m = max((m for m in moves if m[0] <= now), key=lambda m: m[0], default=moves[0])
            begin, finish, R, middle, along, length, turn = m
            u = np.clip(now - begin, 0, finish - begin)
            v, whole = length / (finish - begin - RAMP_S), finish - begin

            way = v * (_ramp(u) + np.clip(u - RAMP_S, 0, whole - 2 * RAMP_S) + RAMP_S / 2 - _ramp(whole - max(u, whole - RAMP_S)))
            share = way / length - 0.5
            out[i] = se3.transform(R @ se3.rotation_exp(turn * share), middle + along * length * share)
        return out

    cycle_s = np.arange(0.0, end, cycle)
    cycle_s = cycle_s[rng.random(len(cycle_s)) >= lost / 10]
    true = at(cycle_s)
    off = pose_sigma * np.array([1, 1, 1, 2e-3, 2e-3, 2e-3]) * rng.normal(size=(len(true), 6))
    reported = se3.transform(se3.rotation_exp(off[:, 3:]) @ true[:, :3, :3], true[:, :3, 3] + off[:, :3])
    exposed = np.arange(0.05, end, 1 / rate_hz)
    between = [m[0] for m in moves]  # from line to line the arm is moved at once
    exposed = exposed[np.all(np.abs(exposed[:, None] - between) > 0.06, axis=1)]
    numbers = np.arange(len(exposed))
    keep = rng.random(len(exposed)) >= lost
    exposed, numbers = exposed[keep], numbers[keep]
    s = se3.apply(se3.inverse(at(exposed) @ X), sphere)
    near = np.abs(s[:, 1]) < 0.85 * RADIUS
    exposed, s, numbers = exposed[near], s[near], numbers[near]
    points = []
    for place in s:
        across = np.arange(-40, 40, 0.25)
        up = np.sqrt(np.maximum(RADIUS**2 - place[1] ** 2 - (across - place[0]) ** 2, 0.0))
        on = up > np.cos(VIEW) * RADIUS
        profile = np.column_stack([across[on], place[2] - up[on]])
        points.append(profile + noise * rng.normal(size=profile.shape))
    middle_s = float(exposed.mean())
    stamped = exposed - delay - drift * (exposed - middle_s) + jitter * rng.normal(size=len(exposed))
    return Sweeps(cycle_s, reported, stamped, points, X, sphere, delay, middle_s, numbers)


def coordinates(made):
    return flange_coordinates(made.reported)
