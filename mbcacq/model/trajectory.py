"""A recording in time as arrays: a run's controller cycles, or another logger's. Reading and writing it is in ``recording``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.model.cell import RobotModel

MOVING_RAD_S = 2e-3  # an axis that is faster moves
MARGIN_S = 0.25  # kept before and after a move
SHORTEST = 250  # samples; a shorter move is dropped


@dataclass(frozen=True)
class Trajectory:
    """T samples of an n-axis arm in time. A signal that the recording lacks is None; a joint that lacks it is a column of NaN.

    Attributes
    ----------
    robot
        The arm.
    time_s : (T,) ndarray
        s.
    q : (T, n) ndarray
        Motor-side angles as the controller reports them, rad.
    q_set, q_joint : (T, n) ndarray or None
        Commanded angles; angles of joint-side encoders, rad.
    torque, motor_torque : (T, n) ndarray or None
        Torque about the joint; torque at the motor, N m.
    current : (T, n) ndarray or None
        Motor currents in ``current_unit``.
    current_unit
        'A' or 'percent'.
    temperatures
        Name of the column (ends in _C) -> (T,) °C.
    extra
        Unknown columns as text.
    name
        Where it came from.
    simulated
        Whether no real arm was recorded.
    simulated_torque : (T, n) ndarray or None
        Torque that the drives of another simulator exert along the same motion, N m. The torque is compared with it; without it, with the
        torque of the robot's rigid bodies.
    """

    robot: RobotModel
    time_s: np.ndarray
    q: np.ndarray
    q_set: np.ndarray | None = None
    q_joint: np.ndarray | None = None
    torque: np.ndarray | None = None
    motor_torque: np.ndarray | None = None
    current: np.ndarray | None = None
    current_unit: str = "A"
    temperatures: Mapping[str, np.ndarray] = field(default_factory=dict)
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    name: str = ""
    simulated: bool = False
    simulated_torque: np.ndarray | None = None


def moves(trajectory: Trajectory, samples: int = 15000) -> list[Trajectory]:
    """The stretches in which the arm moves, with what is before and after, each from rest to rest. A long recording gives so many of them,
    evenly chosen, that about ``samples`` remain. A recording without rest is one stretch."""
    t = trajectory
    step = float(np.median(np.diff(t.time_s)))
    speed = np.abs(np.gradient(t.q, t.time_s, axis=0)).max(axis=1)
    margin = int(MARGIN_S / step)
    near = np.convolve(speed > MOVING_RAD_S, np.ones(2 * margin + 1), mode="same") > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    found = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= SHORTEST]
    total = sum(s.stop - s.start for s in found)
    if total > samples:
        keep = np.unique(np.linspace(0, len(found) - 1, max(int(len(found) * samples / total), 1)).astype(int))
        found = [found[i] for i in keep]
    return [_part(t, s) for s in found]


def _part(t: Trajectory, where: slice) -> Trajectory:
    signals = {
        name: None if getattr(t, name) is None else getattr(t, name)[where]
        for name in ("q", "q_set", "q_joint", "torque", "motor_torque", "current", "simulated_torque")
    }
    return replace(
        t,
        time_s=t.time_s[where],
        **signals,
        temperatures={k: v[where] for k, v in t.temperatures.items()},
        extra={k: v[where] for k, v in t.extra.items()},
    )
