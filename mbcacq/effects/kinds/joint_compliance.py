"""Wind-up of a gearbox: a joint turns beyond its reported angle in proportion to the gravity torque about it.

In motion the joint side lags the motor side by compliance times the torque that passes the gear. Friction in front of the gear winds
nothing up, so the load is the drive's torque without the friction found in its own channel; where no torque was recorded, that of the
rigid-body simulation.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Parameters, Report, number, plain_effect, standard_deviations
from mbcacq.effects.functions import DescribedPart, linear
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available

NAME = "joint_compliance"
DECLARED = Declaration(every_arm=True, same_as_group=True, model_block="gear", challenge=Challenge(number=1, in_motion=4))


def candidates(context: Context) -> list[Candidate]:
    """For each joint that gravity loads, its compliance in rad/(N m)."""
    torque = context.gravity_torque
    out = []
    for i in range(context.n):
        if np.ptp(torque[:, i]) < 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
            continue  # a vertical axis feels no gravity
        cause = f"gravity_torque_{i + 1}"
        described = [DescribedPart("joint", i, 0, (linear(cause),))]
        out.append(plain_effect(NAME, [f"A{i + 1}"], cause, described, {f"A{i + 1}.compliance_rad_per_Nm": 1.5e-6}, positive=True))
    return out


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_joint" or any(run.load is None for run in runs):
        return []
    return [
        Candidate(NAME, (f"A{j + 1}",), f"tau{j + 1}", MotionRows((j,), _columns), _report(runs, j), positive=True) for j in group.joints
    ]


def _columns(run: MotionSignals, joint: int, _: object) -> np.ndarray:
    return -available(run.load)[:, [joint]]


def _report(runs: tuple[MotionSignals, ...], joint: int) -> Report:
    """The load is known only as well as the arm's inertial parameters: that relative uncertainty is added to the compliance's own."""
    relative = max(0.0 if run.load_uncertainty is None else float(run.load_uncertainty[joint]) for run in runs)

    def report(c: np.ndarray, v: np.ndarray, _: HyperEstimate) -> Parameters:
        return {f"A{joint + 1}.compliance_rad_per_Nm": number(c[0], np.hypot(standard_deviations(v)[0], relative * c[0]))}

    return report
