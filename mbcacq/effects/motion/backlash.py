"""Backlash of a gear: the joint side lags by half the clearance, on the side from which it is driven."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, available, plain_report

NAME = "backlash"
CROSSING_S = np.array(
    [0.001, 0.003, 0.01, 0.03]
)  # time constants of crossing the clearance that are tried: a fraction of a cycle to several
LEAST_LOAD = 0.002  # of the largest: below, as at rest, the flank in contact is not known and no displacement is assumed
OVERSAMPLING = 8  # the load changes its sign between two samples
LEAST_SHARE_OF_TIME = 0.02  # on each flank, without which a change of flank cannot be seen


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_joint":
        return []
    out = []
    for j in group.joints:
        axis, width, degrees = f"A{j + 1}", f"A{j + 1}.width_deg", float(np.degrees(1))
        by_direction = plain_report(width, scale=degrees)
        out.append(MotionCandidate(NAME, (axis,), f"direction_{j + 1}", (j,), _by_direction, by_direction, positive=True))
        if all(run.load is not None for run in runs) and _changes_flank(runs, j):
            by_load = plain_report(width, scale=degrees, hyper_name=f"{axis}.crossing_s")
            hyper = {"hyper": CROSSING_S, "hyper_parameter": f"{axis}.crossing_s", "trials": 2.0}
            out.append(MotionCandidate(NAME, (axis,), f"tau{j + 1}", (j,), _by_load, by_load, positive=True, form="load", **hyper))
    return out


def _by_direction(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return -0.5 * run.direction[:, [joint]]


def _by_load(run: MotionSignals, joint: int, crossing_s: float | None) -> np.ndarray:
    """The flank in contact follows the sign of the load, in the time that it takes to cross the clearance."""
    assert crossing_s is not None
    torque = available(run.load)[:, joint]
    load = np.interp(np.arange((len(torque) - 1) * OVERSAMPLING + 1) / OVERSAMPLING, np.arange(len(torque)), torque)
    flank = np.sign(load) * (np.abs(load) > LEAST_LOAD * float(np.abs(load).max()))
    keep = np.exp(-run.step_s / OVERSAMPLING / crossing_s)
    followed = flank[0] + lfilter([1.0 - keep], [1.0, -keep], flank - flank[0])
    return -0.5 * followed[::OVERSAMPLING, None]


def _changes_flank(runs: tuple[MotionSignals, ...], joint: int) -> bool:
    signs = np.concatenate([np.sign(available(run.load)[:, joint]) for run in runs])
    return float(min((signs > 0).mean(), (signs < 0).mean())) > LEAST_SHARE_OF_TIME
