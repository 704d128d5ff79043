"""The actual angle does not follow the set point at once.

A dead time L before a lag T: q = q_set(t - L) / (T s + 1). How much later it is in all, L + T, is the slope of the mismatch over
the speed; that and T leave L. A T of seconds describes a speed loop with a weak position loop around it: what its feed-forward has too
much (a speed, an acceleration) runs away for about T before it is called back, and the actual angle may even lead. What else pushes
such a loop aside (Coulomb friction fed forward, a load) refines it.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, low_pass, plain_report

NAME = "drive_lag"
RESOLUTION_S = 2e-6  # neither dead time nor lag is claimed to be known better: both filters, the arm's and this one, step in time
SLOW_S = 0.2  # a longer time constant is that of a position loop, not of a drive
FAST = np.concatenate([[1e-5], np.geomspace(0.001, 0.15, 9)])
LIKELY = (0.5, 1.0, 1.0)  # too much speed, s of too much acceleration, share of what was away at the start
SLOW = np.geomspace(0.25, 100.0, 12)
BETWEEN = float(np.log(SLOW[1] / SLOW[0])) / np.sqrt(12.0)  # share by which a slow one lies off those tried


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_set":
        return []
    out = []
    for j in group.joints:
        axis = f"A{j + 1}"
        place = ((axis,), f"qd{j + 1}", (j,))
        out.append(MotionCandidate(NAME, *place, _following, _report(axis), hyper=FAST, search=4.0, positive=True, tag="fast"))
        out.append(MotionCandidate(NAME, *place, _loop, _loop_report(axis), hyper=SLOW, search=4.0, refine=False, tag="slow", sigma=LIKELY))
        pushes = [("friction", _friction, "rad_per_s")]
        pushes += [
            (name, _push_by(signal), "rad_per_Nms")
            for name, signal in (("drive", "torque"), ("load", "rigid_set"))
            if all(getattr(run, signal) is not None for run in runs)
        ]
        out += [
            MotionCandidate(
                NAME, *place, columns, plain_report(f"{axis}.{name}_push_{unit}"), extends=True, follows=True, refine=False, tag=name
            )
            for name, columns, unit in pushes
        ]
    return out


def _following(run: MotionSignals, joint: int, lag: float | None) -> np.ndarray:
    """What a dead time and a lag leave, by one second of both together (T, 1)."""
    q_set, time = run.q_set[:, joint], run.step_s * np.arange(len(run.q))
    total = _later(run, joint)
    dead = max(total - lag, 0.0)
    shifted = CubicSpline(time, q_set)(np.clip(time - dead, 0.0, time[-1]))
    total = dead + lag
    return ((low_pass(shifted, lag, run.step_s) - q_set) / total)[:, None]


def _later(run: MotionSignals, joint: int) -> float:
    """By how much (s) the actual angle is late in all: slope over the speed beside the next terms of the series."""
    rates = np.stack([-run.qd_set[:, joint], run.qdd_set[:, joint], -run.qddd_set[:, joint], np.ones(len(run.q))], axis=1)
    scale = np.maximum(np.linalg.norm(rates, axis=0), 1e-300)
    slope = np.linalg.lstsq(rates / scale, run.q[:, joint] - run.q_set[:, joint], rcond=1e-12)[0] / scale
    return max(float(slope[0]), 1e-6)


def _loop(run: MotionSignals, joint: int, lag: float | None) -> np.ndarray:
    """Pushed by speed and acceleration; and what was away at the start fades."""
    time = run.step_s * np.arange(len(run.q))
    away = float(np.mean(run.q[:5, joint] - run.q_set[:5, joint]))
    pushed = [low_pass(rate, lag, run.step_s) * lag for rate in (run.qd_set[:, joint], run.qdd_set[:, joint])]
    return np.stack([*pushed, away * np.exp(-time / lag)], axis=1)


def _friction(run: MotionSignals, joint: int, lag: float | None) -> np.ndarray:
    return lag * low_pass(np.r_[0.0, np.tanh(run.qd_set[1:, joint] / 1e-3)], lag, run.step_s)[:, None]


def _push_by(signal: str):
    def columns(run: MotionSignals, joint: int, lag: float | None) -> np.ndarray:
        push = getattr(run, signal)[:, joint]
        return lag * low_pass(np.r_[0.0, push[1:]], lag, run.step_s)[:, None]

    return columns


def _report(axis: str):
    def report(c: np.ndarray, v: np.ndarray, lag: float | None, std: float) -> dict:
        total, std = float(np.sqrt(max(v[0, 0], 0.0))), float(np.hypot(std, RESOLUTION_S))
        return {
            f"{axis}.latency_s": {"value": float(c[0]) - lag, "std": float(np.hypot(total, std))},
            f"{axis}.time_constant_s": {"value": float(lag), "std": float(std)},
        }

    return report


def _loop_report(axis: str):
    def report(c: np.ndarray, v: np.ndarray, lag: float | None, std: float) -> dict:
        s = np.sqrt(np.maximum(np.diag(v), 0.0))
        return {
            f"{axis}.latency_s": {"value": -float(c[1]), "std": float(s[1])},
            f"{axis}.time_constant_s": {"value": float(lag), "std": float(np.hypot(std, BETWEEN * lag))},
            f"{axis}.speed_gain": {"value": float(c[0]), "std": float(s[0])},
        }

    return report
