"""Backlash: a joint is off by half the width, by the direction of its last motion or by the sign of the gravity torque."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, Part, Report, number

NAME = "backlash"
FEWEST, LEAST = 4, 0.005  # poses, and share of them, at which the torque must have the rarer sign
TRANSITIONS = np.array([0.0, 0.03, 0.1, 0.3, 1.0])  # N m over which the teeth change sides: tanh(torque / transition); 0: at once


def candidates(context: Context) -> list[Candidate]:
    """For each joint that came from both sides, half its width by the direction; for each joint whose load changes sign, by the load.

    Coefficients are in rad, and negative where the joint stays behind its motion.
    """
    out, direction = [], context.obs.direction
    if direction is not None:
        moved = [i for i in range(context.n) if np.ptp(direction[:, i]) > 0]
        out += [by_direction(i, direction[:, i].astype(float)) for i in moved]
    if context.masses_known:
        torque = context.gravity_torque
        fewest = max(FEWEST, LEAST * context.obs.n_poses)
        changes = [i for i in range(context.n) if min(np.sum(torque[:, i] > 0), np.sum(torque[:, i] < 0)) >= fewest]
        out += [under_load(i, torque[:, i]) for i in changes if np.ptp(torque[:, i]) > 0.5]
    if direction is None and not out:
        raise Missing("no senses of motion recorded (dir1..)")
    return out


def by_direction(i: int, direction: np.ndarray) -> Candidate:
    """direction (P,): -1, 0 or 1 of the last motion of joint i."""
    parts = [Part("joint", i, 0, direction[:, None])]
    return Candidate(NAME, (f"A{i + 1}",), f"direction_{i + 1}", lambda _: parts, report_of(i), np.array([3e-5]))


def under_load(i: int, torque: np.ndarray) -> Candidate:
    """torque (P,): N m by gravity about joint i. A transition wider than a twentieth of its range would be compliance."""
    values = TRANSITIONS[TRANSITIONS < 0.05 * np.ptp(torque)]

    def build(transition):
        sign = np.tanh(torque / transition) if transition else np.sign(torque)
        return [Part("joint", i, 0, sign[:, None])]

    hyper = Hyperparameter("transition_Nm", values, 2.0, refine=False, preferred=(0.0,))
    return Candidate(NAME, (f"A{i + 1}",), f"gravity_torque_{i + 1}", build, report_of(i), np.array([3e-5]), hyper)


def report_of(i: int) -> Report:
    """The width, whose half is the size of the coefficient."""

    def report(c, v, _):
        return {f"A{i + 1}.width_deg": number(np.degrees(2 * abs(c[0])), np.degrees(2 * np.sqrt(v[0, 0])))}

    return report
