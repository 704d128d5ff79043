"""Periodic effects: a table of sines whose orders (periods per joint turn) are found in the data, never assumed."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, Report

ANGLE, TORQUE = "gear_transmission_error", "torque_ripple"
SLOWEST = {ANGLE: 0.0, TORQUE: 6.0}  # slower waves of torque are gravity's
BEYOND = np.radians(0.5)
FASTEST = {ANGLE: 1500.0, TORQUE: 1500.0}  # an encoder ring has a thousand lines, a motor some hundred turns with its poles


def wave(group: ChannelGroup, joint: int, order: float, spacing: float, tried: float, seen: tuple[float, float]) -> MotionCandidate:
    """The candidate of one order. spacing: how far apart two orders are that the travelled angle tells apart; tried: how many; seen: the
    angles (rad) at which it was seen: elsewhere its phase is not known, and nothing is claimed."""
    name = ANGLE if group.name == "q_joint" else TORQUE
    key, scale = ("amplitude_deg", float(np.degrees(1))) if name == ANGLE else ("amplitude_Nm", 1.0)
    return MotionCandidate(
        name,
        (f"A{joint + 1}",),
        f"q{joint + 1}",
        (joint,),
        _columns(seen),
        _report(f"A{joint + 1}", key, scale),
        hyper=order + spacing * np.array([-0.5, 0.0, 0.5]),
        search=tried,
        tag=f"{order:.4g}",
    )


def range_of_orders(group: ChannelGroup, runs: tuple[MotionSignals, ...], joint: int) -> tuple[float, float, float] | None:
    """(lowest, highest, spacing) of the orders that the recording can show, None if the joint hardly moved or no wave is physical."""
    if group.name == "q_set":
        return None
    name = ANGLE if group.name == "q_joint" else TORQUE
    travel = max(float(np.ptp(run.q[:, joint])) for run in runs)
    if travel < np.radians(2.0):
        return None
    fastest = max(float(np.abs(run.qd[:, joint]).max()) * run.step_s for run in runs)
    spacing = 2 * np.pi / travel
    lowest = max(SLOWEST[name], 1.5 * spacing)  # more than one whole period was seen
    highest = min(FASTEST[name], np.pi / max(fastest, 1e-9))
    return (lowest, highest, spacing) if highest > lowest else None


def _columns(seen: tuple[float, float]):
    def columns(run: MotionSignals, joint: int, order: float | None) -> np.ndarray:
        q = run.q[:, joint]
        inside = (q >= seen[0] - BEYOND) & (q <= seen[1] + BEYOND)
        return np.stack([np.sin(order * q), np.cos(order * q)], axis=1) * inside[:, None]

    return columns


def _report(axis: str, amplitude_name: str, scale: float) -> Report:
    """amplitude * sin(order q + phase) from the coefficients of sin and cos."""

    def report(c: np.ndarray, v: np.ndarray, order: float | None, std: float) -> dict:
        amplitude = float(np.hypot(*c))
        unit = c / max(amplitude, 1e-300)
        turn = np.array([-unit[1], unit[0]])
        return {
            f"{axis}.order": {"value": float(order), "std": float(std)},
            f"{axis}.{amplitude_name}": {"value": scale * amplitude, "std": scale * float(np.sqrt(max(unit @ v @ unit, 0.0)))},
            f"{axis}.phase_deg": {
                "value": float(np.degrees(np.arctan2(c[1], c[0]))),
                "std": float(np.degrees(np.sqrt(max(turn @ v @ turn, 0.0)) / max(amplitude, 1e-300))),
            },
        }

    return report
