"""Two channels were not sampled at one instant: the late one shows the past.

The column is minus the rate of the channel. Once the effect is selected the recording itself is corrected in time (``channel_delay``),
because long delays of fast motion are not linear, and everything else in the channel is late with it.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, Parameters, number, standard_deviations
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available

NAME = "channel_latency"
DECLARED = Declaration(motor_side=True, model_block="sensor_delay", challenge=Challenge(in_motion=1))
RESOLUTION_S = 1e-7  # splines between samples compare two time bases no better
WINDOW_S = 0.25  # of the quintic through a recorded torque: shorter ones leave noise, which would shrink the slope


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name == "q_set":  # a late set point and a late drive are indistinguishable: drive_lag reports it, joint by joint
        return []
    torque = group.name == "tau"
    rows = MotionRows(group.joints, _torque if torque else lambda run, joint, _: -run.qd[:, [joint]], channel_delay=True)
    hyper = Hyperparameter("", np.array([0.0]), 1.0, refine=False)
    return [Candidate(NAME, (group.name,), "rate" if torque else "qd", rows, _report, hyper)]


def _torque(run: MotionSignals, joint: int, _: object) -> np.ndarray:
    window = min(max(2 * int(WINDOW_S / run.step_s / 2) + 1, 7), (len(run.q) - 1) // 2 * 2 - 1)
    from scipy.signal import savgol_filter  # takes half a second, which most commands do not need

    return -np.asarray(savgol_filter(available(run.torque)[:, joint], window, 5, deriv=1, delta=run.step_s))[:, None]


def _report(c: np.ndarray, v: np.ndarray, delay: HyperEstimate) -> Parameters:
    """The shift that was corrected in the recording, and the remaining delay."""
    return {"latency_s": number(delay.value + c[0], np.hypot(standard_deviations(v)[0], RESOLUTION_S))}
