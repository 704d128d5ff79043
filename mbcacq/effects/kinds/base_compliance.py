"""A pedestal that tilts under the overturning moment, with the same compliance about every axis."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, Support, plain_effect
from mbcacq.effects.functions import DescribedPart, linear

NAME = "base_compliance"
LARGEST_TILT = 0.02  # rad: a platform on tyres sinks by 10 mm over half a metre; anchored pedestals tilt by less than 1 mrad
DECLARED = Declaration(challenge=Challenge(number=2))


def candidates(context: Context) -> list[Candidate]:
    """One candidate; its coefficient is in rad/(N m)."""
    if not context.masses_known:
        raise Missing("no masses of the links given")
    described = [DescribedPart("frame", 0, 3 + c, (linear(f"gravity_moment_0_{'xyz'[c]}"),)) for c in range(3)]
    largest = LARGEST_TILT / max(float(np.abs(context.gravity_moment(0)).max()), 1e-9)
    support = Support(largest, f"no pedestal that stands tilts by more than {LARGEST_TILT * 1e3:.0f} mrad under the arm's own weight")
    size = {"compliance_rad_per_Nm": 1e-7}
    return [plain_effect(NAME, ["base"], "gravity_torque_2", described, size, positive=True, support=support)]
