"""Wind-up of a gearbox: a joint turns beyond its reported angle in proportion to the gravity torque about it."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, scalar_report
from mbcacq.effects.functions import DescribedPart, linear

NAME = "joint_compliance"
DECLARED = Declaration(every_arm=True, same_as_group=True, challenge=Challenge(number=1))


def candidates(context: Context) -> list[Candidate]:
    """For each joint that gravity loads, its compliance in rad/(N m)."""
    torque = context.gravity_torque
    out = []
    for i in range(context.n):
        if np.ptp(torque[:, i]) < 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
            continue  # a vertical axis feels no gravity
        cause = f"gravity_torque_{i + 1}"
        described = [DescribedPart("joint", i, 0, (linear(cause),))]
        out.append(
            Candidate(
                NAME, (f"A{i + 1}",), cause, described, scalar_report(f"A{i + 1}.compliance_rad_per_Nm"), np.array([1.5e-6]), positive=True
            )
        )
    return out
