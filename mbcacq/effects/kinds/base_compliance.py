"""A pedestal that tilts under the overturning moment, with the same compliance about every axis."""

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, plain_effect
from mbcacq.effects.functions import DescribedPart, linear

NAME = "base_compliance"
DECLARED = Declaration(challenge=Challenge(number=2))


def candidates(context: Context) -> list[Candidate]:
    """One candidate; its coefficient is in rad/(N m)."""
    if not context.masses_known:
        raise Missing("no masses of the links given")
    described = [DescribedPart("frame", 0, 3 + c, (linear(f"gravity_moment_0_{'xyz'[c]}"),)) for c in range(3)]
    return [plain_effect(NAME, ["base"], "gravity_torque_2", described, {"compliance_rad_per_Nm": 1e-7}, positive=True)]
