"""A pedestal that tilts under the overturning moment, with the same compliance about every axis."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, scalar_report

NAME = "base_compliance"


def candidates(context: Context) -> list[Candidate]:
    """One candidate; its coefficient is in rad/(N m)."""
    if not context.masses_known:
        raise Missing("no masses of the links given")
    moment = context.gravity_moment(0)
    parts = [Part("frame", 0, 3 + c, moment[:, c : c + 1]) for c in range(3)]
    return [
        Candidate(
            NAME, ("base",), "gravity_torque_2", lambda _: parts, scalar_report("compliance_rad_per_Nm"), np.array([1e-7]), positive=True
        )
    ]
