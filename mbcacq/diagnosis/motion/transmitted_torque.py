"""The torque that passes the gears, as far as it is known: without friction, rotor, torque ripple, delay, which act on the motor side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from mbcacq.diagnosis.motion.fit import FittedEffect, MotionFit
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import MotionSignals, available


def with_load(runs: tuple[MotionSignals, ...], torque: MotionFit) -> tuple[MotionSignals, ...]:
    """The runs with the torque that passes the gears, joint by joint, and its error.

    Where the torque is explained, that of the arm as it was found, without what acts on the motor side; else the drive's torque, less
    its friction, which is wrong by a share of itself.
    """
    explained = torque.train_after < NUMBERS.explained_chi2_dof * torque.floor**2
    lost = [e for e in torque.effects if catalogue.declaration(e.candidate.name).motor_side]
    passed = [e for e in torque.effects if not catalogue.declaration(e.candidate.name).motor_side]
    out = []
    for k, run in enumerate(runs):
        load = available(run.rigid).copy()
        for j, joint in enumerate(torque.group.joints):
            if explained[j]:
                load[:, joint] += torque.links[j][k] + _sum(passed, j, k)
            else:
                load[:, joint] = _smooth(available(run.torque)[:, joint] - _sum(lost, j, k), run.step_s)
        out.append(replace(run, load=load, load_error=_error(torque, explained, k, load)))
    return tuple(out)


def _error(torque: MotionFit, explained: np.ndarray, run: int, load: np.ndarray) -> np.ndarray:
    """(T, n, r) of the load (T, n) of one run: the errors that explained joints have in common, then one of each other joint."""
    common = torque.load_error[run]
    alone = np.flatnonzero(~explained)
    out = np.zeros((*load.shape, common.shape[2] + len(alone)))
    for j, joint in enumerate(torque.group.joints):
        if explained[j]:
            out[:, joint, : common.shape[2]] = common[:, j]
    for r, j in enumerate(alone, common.shape[2]):
        joint = torque.group.joints[j]
        out[:, joint, r] = NUMBERS.unexplained_load_uncertainty * load[:, joint]
    return out


def _sum(effects: list[FittedEffect], j: int, run: int) -> np.ndarray | float:
    return sum((e.contributions[j][run] for e in effects), 0.0)


def _smooth(load: np.ndarray, step_s: float) -> np.ndarray:
    window = min(max(2 * int(NUMBERS.load_window_s / step_s / 2) + 1, 5), (len(load) - 1) // 2 * 2 - 1)
    return np.asarray(savgol_filter(load, window, 2))
