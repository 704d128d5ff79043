"""The shape of an effect in time: columns of a channel's mismatch, linear in coefficients, perhaps with hyper-parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Run:
    """One trajectory on an equidistant clock. Arrays (T, n), rad, rad/s, rad/s^2, N m on the joint side; None where not recorded.

    q is the motor-side angle the controller reports; q_set the command; q_joint the joint-side encoder (NaN columns where a
    joint has none); torque the drive's torque at the joint, load the part of it that passes the gear (friction taken out); rigid the
    torque of the rigid-body simulation; gravity its static part.
    """

    step_s: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    q_set: np.ndarray | None = None
    q_joint: np.ndarray | None = None
    torque: np.ndarray | None = None
    load: np.ndarray | None = None
    rigid: np.ndarray | None = None
    gravity: np.ndarray | None = None
    gear_ratio: np.ndarray | None = None


@dataclass(frozen=True)
class Channel:
    """A mismatch to explain. name: 'q_joint', 'q_set' or 'tau'; joint: 0..n-1. mismatch, base: one array per run, (T,) and (T, b).

    base holds what may always differ (an offset, inertial parameters within their prior); prior: (b,) sigma of each, inf if free.
    """

    name: str
    joint: int
    unit: str
    mismatch: tuple[np.ndarray, ...]
    base: tuple[np.ndarray, ...]
    prior: np.ndarray

    @property
    def axis(self) -> str:
        return f"A{self.joint + 1}"


@dataclass(frozen=True)
class Candidate:
    """columns(run, joint, hyper) -> (T, k). hyper: values to try (H,), or None. report(coefficients, covariance, hyper) -> parameters.

    positive: physics demands a positive first coefficient. several: may be taken again with another hyper value. search: number of
    independent hyper values tried, for the p-value. shared: one coefficient for all joints of the channel.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    columns: Callable[[Run, int, float | None], np.ndarray]
    report: Callable[[np.ndarray, np.ndarray, float | None], dict]
    hyper: np.ndarray | None = None
    positive: bool = False
    several: bool = False
    search: float = 1.0
    shared: bool = False


def value(prefix: str, number: float, variance: float) -> dict:
    return {prefix: {"value": float(number), "std": float(np.sqrt(max(variance, 0.0)))}}


def sense(run: Run, joint: int, threshold: float = 1e-3) -> np.ndarray:
    """Smoothed sign of the speed (T,): below ``threshold`` rad/s the sense of a joint is not known sharply."""
    return np.tanh(run.qd[:, joint] / threshold)


def sine_report(amplitude_name: str, scale: float, phase_sign: float = 1.0) -> Callable[[np.ndarray, np.ndarray, float | None], dict]:
    """Report of coefficients (of sin, of cos) at an order: amplitude, phase with amplitude * sin(order q + phase)."""

    def report(c: np.ndarray, v: np.ndarray, order: float | None) -> dict:
        amplitude = float(np.hypot(*c))
        unit = c / max(amplitude, 1e-300)
        turn = np.array([-unit[1], unit[0]])
        return {
            "order": {"value": float(order), "std": 0.0},
            amplitude_name: {"value": scale * amplitude, "std": scale * float(np.sqrt(unit @ v @ unit))},
            "phase_deg": {"value": phase_sign * float(np.degrees(np.arctan2(c[1], c[0]))),
                          "std": float(np.degrees(np.sqrt(turn @ v @ turn) / max(amplitude, 1e-300)))},
        }

    return report


def orders(runs: tuple[Run, ...], joint: int, highest: float) -> np.ndarray:
    """Orders (per joint turn) worth trying: as fine as the travelled angle can tell apart, and fine enough to be sampled."""
    travel = max(float(np.ptp(run.q[:, joint])) for run in runs)
    if travel < np.radians(2.0):
        return np.zeros(0)
    fastest = max(float(np.abs(np.diff(run.q[:, joint])).max()) for run in runs)
    top = min(highest, np.pi / max(fastest, 1e-9) / 2)
    lowest = 2 * np.pi / travel  # at least one period seen
    return np.arange(lowest, max(top, lowest), 0.25 * 2 * np.pi / travel)
