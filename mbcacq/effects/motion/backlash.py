"""Play in the gearbox: the joint side hangs back by half the width, on the side it is driven from."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "backlash"
CROSSING_S = np.array([0.001, 0.003, 0.01, 0.03])  # time constants of crossing the play that are tried
LEAST_LOAD = 0.002  # of the largest: below, as at rest, the flank in contact is not known and nothing is said
FINER = 8  # the load changes its sign between two samples


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "q_joint":
        return []
    out = []
    for j in group.joints:
        report = plain_report(f"A{j + 1}.width_deg", scale=float(np.degrees(1)))
        load_report = plain_report(f"A{j + 1}.width_deg", scale=float(np.degrees(1)), hyper_name=f"A{j + 1}.crossing_s")
        out.append(MotionCandidate(NAME, (f"A{j + 1}",), f"direction_{j + 1}", (j,), _by_motion, report, positive=True))
        if all(run.load is not None for run in runs) and _changes_flank(runs, j):
            out.append(
                MotionCandidate(
                    NAME,
                    (f"A{j + 1}",),
                    f"tau{j + 1}",
                    (j,),
                    _by_load,
                    load_report,
                    hyper=CROSSING_S,
                    search=2.0,
                    positive=True,
                    tag="load",
                )
            )
    return out


def _by_motion(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return -0.5 * run.sense[:, [joint]]


def _by_load(run: MotionSignals, joint: int, crossing_s: float | None) -> np.ndarray:
    """The flank in contact follows the sign of the load, in the time that it takes to cross the play."""
    time = np.arange(len(run.load))
    load = np.interp(np.arange((len(run.load) - 1) * FINER + 1) / FINER, time, run.load[:, joint])
    flank = np.sign(load) * (np.abs(load) > LEAST_LOAD * float(np.abs(load).max()))
    keep = np.exp(-run.step_s / FINER / crossing_s)
    followed = flank[0] + lfilter([1.0 - keep], [1.0, -keep], flank - flank[0])
    return -0.5 * followed[::FINER, None]


def _changes_flank(runs: tuple[MotionSignals, ...], joint: int) -> bool:
    signs = np.concatenate([np.sign(run.load[:, joint]) for run in runs])
    return float(min((signs > 0).mean(), (signs < 0).mean())) > 0.02
