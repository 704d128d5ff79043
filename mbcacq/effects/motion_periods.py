"""Periodic components of a mismatch in motion in a joint's own angle.

Each is a sine and cosine whose order (periods per turn of the joint) is found in the data, never assumed.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.declaration import PeriodicInMotion
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, Parameters, Report, angle, number
from mbcacq.effects.learnt_range import own_angle
from mbcacq.effects.motion_effect import Columns, MotionRows, MotionSignals
from mbcacq.quantities import DEGREE

HIGHEST_ORDER = 1500.0  # an encoder ring has a thousand lines, a motor some hundred turns with its poles
LEAST_TRAVEL = 2.0 * DEGREE  # below, a joint hardly moved
LEAST_PERIODS = 1.5  # in the observed travel: more than one whole period
OUTSIDE = 0.5 * DEGREE  # beyond the observed angles, where a phase is still known


def periodic_component(
    effect: tuple[str, PeriodicInMotion], joint: int, axis: str, order: float, spacing: float, trials: float, observed: tuple[float, float]
) -> Candidate:
    """The candidate of one order of a joint, given by its index and its name. effect: its name, and how it is periodic; spacing: of the
    orders to try around it; trials: how many were compared; observed: lowest and highest angle (rad) of the data that take part: elsewhere
    its phase is not known, and it is zero."""
    name, declared = effect
    rows, report = MotionRows((joint,), _columns(observed)), _report(axis, declared.amplitude, declared.scale)
    hyper = Hyperparameter("", order + spacing * np.array([-0.5, 0.0, 0.5]), trials)
    return Candidate(name, (axis,), own_angle(axis), rows, report, hyper, several=True, variant=f"{order:.4g}")


def range_of_orders(lowest_order: float, runs: tuple[MotionSignals, ...], joint: int) -> tuple[float, float, float] | None:
    """The lowest from ``lowest_order`` on and the highest that the recordings can show, and the distance of two orders that the travelled
    angle distinguishes; None if the joint hardly moved."""
    travel = max(float(np.ptp(run.q[:, joint])) for run in runs)
    if travel < LEAST_TRAVEL:
        return None
    fastest = max(float(np.abs(run.qd[:, joint]).max()) * run.step_s for run in runs)
    spacing = 2 * np.pi / travel
    lowest = max(lowest_order, LEAST_PERIODS * spacing)
    highest = min(HIGHEST_ORDER, np.pi / max(fastest, 1e-9))  # two samples a period at the highest speed
    return (lowest, highest, spacing) if highest > lowest else None


def _columns(observed: tuple[float, float]) -> Columns:
    def columns(run: MotionSignals, joint: int, order: float) -> np.ndarray:
        q = run.q[:, joint]
        inside = (q >= observed[0] - OUTSIDE) & (q <= observed[1] + OUTSIDE)
        return np.stack([np.sin(order * q), np.cos(order * q)], axis=1) * inside[:, None]

    return columns


def _report(axis: str, amplitude_name: str, scale: float) -> Report:
    """amplitude * sin(order q + phase) from the coefficients of sine and cosine."""

    def report(c: np.ndarray, v: np.ndarray, order: HyperEstimate) -> Parameters:
        amplitude = float(np.hypot(*c))
        radial = c / max(amplitude, 1e-300)
        tangential = np.array([-radial[1], radial[0]])
        phase_std = np.sqrt(max(tangential @ v @ tangential, 0.0)) / max(amplitude, 1e-300)
        return {
            f"{axis}.order": number(order.value, order.std),
            f"{axis}.{amplitude_name}": number(scale * amplitude, scale * float(np.sqrt(max(radial @ v @ radial, 0.0)))),
            f"{axis}.phase_deg": angle(np.arctan2(c[1], c[0]), float(phase_std)),
        }

    return report
