"""The actual angle does not follow the set point at once.

A dead time L before a lag T: q = q_set(t - L) / (T s + 1). The total delay, L + T, is the slope of the mismatch over the speed; with T it
gives L. A T of seconds describes a speed loop with a weak position loop around it. An excess of its feed-forward (of a speed, of an
acceleration) adds up for about T before it is corrected, and the actual angle may even lead. Other disturbances of such a loop (Coulomb
friction fed forward, a load) refine it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, Parameters, Report, number, plain_report, standard_deviations
from mbcacq.effects.motion_effect import ChannelGroup, Columns, MotionRows, MotionSignals, available, low_pass

NAME = "drive_lag"
DECLARED = Declaration(every_arm=True, challenge=Challenge(in_motion=2))
RESOLUTION_S = 2e-6  # neither dead time nor lag is known better: both filters, the arm's and this one, step in time
LAGS_S = np.concatenate([[1e-5], np.geomspace(0.001, 0.15, 9)])  # time constants of a drive
LOOPS_S = np.geomspace(0.25, 100.0, 12)  # a time constant above 0.2 s is that of a position loop, not of a drive
LOOP_SIGMA = (0.5, 1.0, 1.0)  # prior: excess of the speed, s of excess acceleration, share of the initial deviation
LOOP_SPACING = float(np.log(LOOPS_S[1] / LOOPS_S[0])) / np.sqrt(12.0)  # relative standard deviation of a value between those tried
FRICTION_SPEED = 1e-3  # rad/s, at which friction that is fed forward changes its sign
FEWEST_S = 1e-6  # least total delay: a column is divided by it


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_set":
        return []
    out = []
    for j in group.joints:
        axis = group.axes[j]
        here = (axis,), f"qd{group.tags[j]}"
        lag = Hyperparameter(f"{axis}.time_constant_s", LAGS_S, 4.0, from_none=True)
        loop = Hyperparameter(f"{axis}.time_constant_s", LOOPS_S, 4.0, refine=False)
        out.append(Candidate(NAME, *here, MotionRows((j,), _lag), _lag_report(axis), lag, positive=True, variant="fast"))
        out.append(Candidate(NAME, *here, MotionRows((j,), _loop, LOOP_SIGMA), _loop_report(axis), loop, variant="slow"))
        for name, columns, unit in _disturbances(runs):
            report = plain_report(f"{axis}.{name}_push_{unit}")
            rows = MotionRows((j,), columns, extends=True, shares_hyper=True)
            out.append(Candidate(NAME, *here, rows, report, variant=name))
    return out


def _disturbances(runs: tuple[MotionSignals, ...]) -> list[tuple[str, Columns, str]]:
    """(name, columns, unit) of what may disturb a slow loop."""
    out = [("friction", _pushed(lambda run: np.tanh(available(run.qd_set) / FRICTION_SPEED)), "rad_per_s")]
    if all(run.torque is not None for run in runs):
        out.append(("drive", _pushed(lambda run: run.torque), "rad_per_Nms"))
    if all(run.rigid_set is not None for run in runs):
        out.append(("load", _pushed(lambda run: run.rigid_set), "rad_per_Nms"))
    return out


def _lag(run: MotionSignals, joint: int, lag: float) -> np.ndarray:
    """Deviation (T, 1) that a dead time and a lag cause, by one second of both together."""
    from scipy.interpolate import CubicSpline  # takes a fifth of a second, which most commands do not need

    q_set, time = available(run.q_set)[:, joint], run.step_s * np.arange(len(run.q))
    dead = max(_total_delay(run, joint) - lag, 0.0)
    shifted = CubicSpline(time, q_set)(np.clip(time - dead, 0.0, time[-1]))
    return ((low_pass(shifted, lag, run.step_s) - q_set) / (dead + lag))[:, None]


def _total_delay(run: MotionSignals, joint: int) -> float:
    """Total delay (s) of the actual angle: its slope over the speed, fitted together with the next terms of the series."""
    qd, qdd, qddd = (available(rate)[:, joint] for rate in (run.qd_set, run.qdd_set, run.qddd_set))
    rates = np.stack([-qd, qdd, -qddd, np.ones(len(run.q))], axis=1)
    scale = np.maximum(np.linalg.norm(rates, axis=0), 1e-300)
    slope = np.linalg.lstsq(rates / scale, run.q[:, joint] - available(run.q_set)[:, joint], rcond=1e-12)[0] / scale
    return max(float(slope[0]), FEWEST_S)


def _loop(run: MotionSignals, joint: int, lag: float) -> np.ndarray:
    """Excess of speed and acceleration fed forward; and the deviation at the start, which fades."""
    time = run.step_s * np.arange(len(run.q))
    initial = float(np.mean(run.q[:5, joint] - available(run.q_set)[:5, joint]))
    rates = (available(run.qd_set)[:, joint], available(run.qdd_set)[:, joint])
    fed_forward = [low_pass(rate, lag, run.step_s) * lag for rate in rates]
    return np.stack([*fed_forward, initial * np.exp(-time / lag)], axis=1)


def _pushed(by: Callable[[MotionSignals], np.ndarray | None]) -> Columns:
    return lambda run, joint, lag: lag * low_pass(np.r_[0.0, available(by(run))[1:, joint]], lag, run.step_s)[:, None]


def _lag_report(axis: str) -> Report:
    def report(c: np.ndarray, v: np.ndarray, lag: HyperEstimate) -> Parameters:
        std = np.hypot(lag.std, RESOLUTION_S)
        return {
            f"{axis}.latency_s": number(c[0] - lag.value, np.hypot(standard_deviations(v)[0], std)),
            f"{axis}.time_constant_s": number(lag.value, std),
        }

    return report


def _loop_report(axis: str) -> Report:
    def report(c: np.ndarray, v: np.ndarray, lag: HyperEstimate) -> Parameters:
        s = standard_deviations(v)
        return {
            f"{axis}.latency_s": number(-c[1], s[1]),
            f"{axis}.time_constant_s": number(lag.value, np.hypot(lag.std, LOOP_SPACING * lag.value)),
            f"{axis}.speed_gain": number(c[0], s[0]),
        }

    return report
