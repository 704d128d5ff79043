"""Wind-up of a gearbox: a joint turns beyond its reported angle in proportion to the gravity torque about it.

In motion the joint side lags the motor side by compliance times the torque that passes the gear. Friction in front of the gear winds
nothing up, so the load is the drive's torque without the friction found in its own channel; where no torque was recorded, that of the
rigid-body simulation.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Support, plain_effect, plain_report
from mbcacq.effects.functions import DescribedPart, linear
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available

NAME = "joint_compliance"
# Strain wave gears twist by 1 to 3 mrad at their rated torque (data sheets: torque over K1..K3), twice as much with a torque sensor behind
# them; cycloidal gears by a tenth of that.
LARGEST_WIND_UP = 0.01  # rad under the largest gravity torque
TYPICAL_WIND_UP = 3e-4  # rad of a class of arms that span 0.03 to 3 mrad; of unknown masses only the product with the compliance shows
TYPICAL = 1.5e-6  # rad/(N m) of a gearbox for 10 to 20 kg on the flange
DECLARED = Declaration(every_arm=True, same_as_group=True, model_block="gear", challenge=Challenge(number=1, in_motion=4))


def candidates(context: Context) -> list[Candidate]:
    """For each joint that gravity loads, its compliance in rad/(N m); of the torques of ``Covariates.links`` where no masses are given."""
    torque = context.gravity_torque
    out = []
    for i in range(context.n):
        if np.ptp(torque[:, i]) < 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
            continue  # a vertical axis feels no gravity
        cause = f"gravity_torque_{context.tags[i]}"
        described = [DescribedPart("joint", i, 0, (linear(cause),))]
        most = float(np.abs(torque[:, i]).max())
        limit = f"no gearbox winds up by more than {LARGEST_WIND_UP * 1e3:.0f} mrad under the arm's own weight"
        support = Support(LARGEST_WIND_UP / most, limit)
        size = {f"{context.axes[i]}.compliance_rad_per_Nm": TYPICAL if context.masses_known else TYPICAL_WIND_UP / most}
        out.append(plain_effect(NAME, [context.axes[i]], cause, described, size, positive=True, support=support))
    return out


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "q_joint" or any(run.load is None for run in runs):
        return []
    out = []
    for j in group.joints:
        rows = MotionRows((j,), lambda run, joint, _: -available(run.load)[:, [joint]], linear_in_load=True)
        report = plain_report(f"{group.axes[j]}.compliance_rad_per_Nm")
        out.append(Candidate(NAME, (group.axes[j],), f"tau{group.tags[j]}", rows, report, positive=True))
    return out
