"""Backlash: a joint is off by half the width, by the direction of its last motion or by the sign of the gravity torque."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, Report, number
from mbcacq.effects.functions import DescribedPart, linear, of

NAME = "backlash"
DECLARED = Declaration(needs=("direction",), challenge=Challenge(number=5))
FEWEST, LEAST = 4, 0.005  # poses, and share of them, at which the torque must have the rarer sign
TRANSITIONS = np.array([0.0, 0.03, 0.1, 0.3, 1.0])  # N m over which the teeth change sides: tanh(torque / transition); 0: at once
AT_ONCE = 1e-9  # N m, over which a hyperbolic tangent is the sign of any torque


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
    cause = f"direction_{i + 1}"
    parts = [DescribedPart("joint", i, 0, (linear(cause),))]
    return Candidate(NAME, (f"A{i + 1}",), cause, parts, report_of(i), np.array([3e-5]))


def under_load(context: Context, i: int) -> Candidate:
    """By the gravity torque about joint i. A transition wider than a twentieth of its range would be compliance."""
    values, cause = TRANSITIONS[TRANSITIONS < 0.05 * np.ptp(context.gravity_torque[:, i])], f"gravity_torque_{i + 1}"

    def described(transition):
        return [DescribedPart("joint", i, 0, (of(cause, "tanh", np.maximum(transition, AT_ONCE)),))]

    hyper = Hyperparameter("transition_Nm", values, 2.0, refine=False, preferred=(0.0,))
    return Candidate(NAME, (f"A{i + 1}",), cause, described, report_of(i), np.array([3e-5]), hyper)


def report_of(i: int) -> Report:
    """The width, whose half is the size of the coefficient."""

    def report(c, v, _):
        return {f"A{i + 1}.width_deg": number(np.degrees(2 * abs(c[0])), np.degrees(2 * np.sqrt(v[0, 0])))}

    return report
