"""Two channels were not sampled at one instant: the late one shows the past.

signal(t - L) - signal(t) is linear in L only for short delays; it is written as L times the mean slope over the delay, and the delay of
that mean is the one estimated (``tuned``). The first form would leave L^2/2 times the acceleration, which looks like a scale.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from mbcacq.physics.trajectory.effect import RESOLUTION_S, Candidate, Group, Run, plain_report

NAME = "channel_latency"
SHORTEST_S = 1e-6
WINDOW_S = 0.25       # of the quintic through a recorded torque: shorter ones leave noise, which would shrink the slope


def candidates(group: Group, runs: tuple[Run, ...]) -> list[Candidate]:
    if group.name == "q_set":  # a late set point and a late drive are one and the same: drive_lag says it, joint by joint
        return []
    columns, depends = (_torque, "rate") if group.name == "tau" else (_encoder, "qd")
    return [Candidate(NAME, (group.name,), depends, group.joints, columns, plain_report("latency_s", least=RESOLUTION_S),
                      hyper=np.array([SHORTEST_S]), refine=False, tuned=True)]


def _encoder(run: Run, joint: int, delay: float | None) -> np.ndarray:
    return _mean_slope(run.smooth[:, joint], run.qd[:, joint], delay, run.step_s)


def _torque(run: Run, joint: int, delay: float | None) -> np.ndarray:
    # What was recorded is the late one: what belongs to now is its future.
    window = min(max(2 * int(WINDOW_S / run.step_s / 2) + 1, 7), (len(run.q) - 1) // 2 * 2 - 1)
    smooth = savgol_filter(run.torque[:, joint], window, 5)
    return _mean_slope(smooth, np.gradient(smooth, run.step_s), -delay, run.step_s)


def _mean_slope(signal: np.ndarray, rate: np.ndarray, delay: float, step: float) -> np.ndarray:
    """[signal(t - delay) - signal(t)] / delay as a column (T, 1)."""
    if abs(delay) < 1e-3 * step:
        return -rate[:, None]
    time = step * np.arange(len(signal))
    return ((CubicSpline(time, signal)(np.clip(time - delay, 0.0, time[-1])) - signal) / delay)[:, None]
