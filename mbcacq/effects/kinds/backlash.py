"""Backlash: a joint is off by half the width, by the direction of its last motion or by the sign of the gravity torque.

In motion the joint side lags by half the clearance, on the side from which it is driven.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, Report, StandstillRows, Support, angle, plain_report
from mbcacq.effects.functions import DescribedPart, linear, of
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available
from mbcacq.quantities import in_degrees

NAME = "backlash"
DECLARED = Declaration(needs=("direction",), challenge=Challenge(number=5, in_motion=5))
FEWEST, LEAST = 4, 0.005  # poses, and share of them, at which the torque must have the rarer sign
TRANSITIONS = np.array([0.0, 0.03, 0.1, 0.3, 1.0])  # N m over which the teeth change sides: tanh(torque / transition); 0: at once
AT_ONCE = 1e-9  # N m, over which a hyperbolic tangent is the sign of any torque
CROSSING_S = np.array([0.001, 0.003, 0.01, 0.03])  # time constants of crossing the clearance: a fraction of a cycle to several
LEAST_LOAD = 0.002  # of the largest: below, as at rest, the flank in contact is not known and no displacement is assumed
OVERSAMPLING = 8  # the load changes its sign between two samples
# rad, half of it: planetary gears of low price have a clearance of 20 to 30 arc minutes.
LARGEST = Support(5e-3, "no gear has a clearance of more than 10 mrad")
LEAST_SHARE_OF_TIME = 0.02  # on each flank, without which a change of flank cannot be seen


def candidates(context: Context) -> list[Candidate]:
    """For each joint that came from both sides, half its width by the direction; for each joint whose load changes sign, by the load.

    Coefficients are in rad, and negative where the joint stays behind its motion.
    """
    out, direction = [], context.obs.direction
    if direction is not None:
        moved = [i for i in range(context.n) if np.ptp(direction[:, i]) > 0]
        out += [by_direction(context, i) for i in moved]
    if context.masses_known:
        torque = context.gravity_torque
        fewest = max(FEWEST, LEAST * context.obs.n_poses)
        changes = [i for i in range(context.n) if min(np.sum(torque[:, i] > 0), np.sum(torque[:, i] < 0)) >= fewest]
        out += [under_load(context, i) for i in changes if np.ptp(torque[:, i]) > 0.5]
    if direction is None and not out:
        raise Missing("no senses of motion recorded (dir1..)")
    return out


def by_direction(context: Context, i: int) -> Candidate:
    """By the direction of the last motion of joint i: -1, 0 or 1."""
    cause = f"direction_{context.tags[i]}"
    parts = [DescribedPart("joint", i, 0, (linear(cause),))]
    return Candidate(NAME, (context.axes[i],), cause, StandstillRows(parts, np.array([3e-5])), report_of(context.axes[i]), support=LARGEST)


def under_load(context: Context, i: int) -> Candidate:
    """By the gravity torque about joint i. A transition wider than a twentieth of its range would be compliance."""
    values, cause = TRANSITIONS[TRANSITIONS < 0.05 * np.ptp(context.gravity_torque[:, i])], f"gravity_torque_{context.tags[i]}"

    def described(transition):
        return [DescribedPart("joint", i, 0, (of(cause, "tanh", np.maximum(transition, AT_ONCE)),))]

    hyper, rows = Hyperparameter("transition_Nm", values, 2.0, refine=False, preferred=(0.0,)), StandstillRows(described, np.array([3e-5]))
    return Candidate(NAME, (context.axes[i],), cause, rows, report_of(context.axes[i]), hyper, support=LARGEST)


def report_of(axis: str) -> Report:
    """The width, whose half is the size of the coefficient."""
    return lambda c, v, _: {f"{axis}.width_deg": angle(2 * abs(c[0]), 2 * np.sqrt(v[0, 0]))}


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_joint":
        return []
    out = []
    for j in group.joints:
        axis, width, degrees = group.axes[j], f"{group.axes[j]}.width_deg", float(in_degrees(1))
        rows = MotionRows((j,), lambda run, joint, _: -0.5 * run.direction[:, [joint]])
        report = plain_report(width, scale=degrees)
        out.append(Candidate(NAME, (axis,), f"direction_{group.tags[j]}", rows, report, positive=True))
        if all(run.load is not None for run in runs) and _changes_flank(runs, j):
            rows, hyper = MotionRows((j,), _by_load), Hyperparameter(f"{axis}.crossing_s", CROSSING_S, 2.0)
            report = plain_report(width, scale=degrees, hyper_name=hyper.name)
            out.append(Candidate(NAME, (axis,), f"tau{group.tags[j]}", rows, report, hyper, positive=True, variant="load"))
    return out


def _by_load(run: MotionSignals, joint: int, crossing_s: float) -> np.ndarray:
    """The flank in contact follows the sign of the load, in the time that it takes to cross the clearance."""
    from scipy.signal import lfilter  # takes half a second, which most commands do not need

    torque = available(run.load)[:, joint]
    load = np.interp(np.arange((len(torque) - 1) * OVERSAMPLING + 1) / OVERSAMPLING, np.arange(len(torque)), torque)
    flank = np.sign(load) * (np.abs(load) > LEAST_LOAD * float(np.abs(load).max()))
    keep = np.exp(-run.step_s / OVERSAMPLING / crossing_s)
    followed = flank[0] + lfilter([1.0 - keep], [1.0, -keep], flank - flank[0])
    return -0.5 * followed[::OVERSAMPLING, None]


def _changes_flank(runs: tuple[MotionSignals, ...], joint: int) -> bool:
    signs = np.concatenate([np.sign(available(run.load)[:, joint]) for run in runs])
    return float(min((signs > 0).mean(), (signs < 0).mean())) > LEAST_SHARE_OF_TIME
