"""A carousel (the first link, with its bearing) that tilts under the overturning moment, about the axes that turn with it."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.described import built
from mbcacq.effects.effect import Candidate, Missing, scalar_report
from mbcacq.effects.functions import DescribedPart, linear

NAME = "carousel_compliance"


def candidates(context: Context) -> list[Candidate]:
    """The same compliance across the first axis in both directions, in rad/(N m); a base that tilts about its own axes is base_compliance."""
    if not context.masses_known:
        raise Missing("no masses of the links given")
    chain = context.obs.cell.robot.chain
    # The first axis in the frame behind the first link, which turns about it.
    axis = chain.link_transforms(np.zeros((1, context.n)))[0, 0, :3, :3].T @ np.array([0.0, 0.0, 1.0])
    moment = [f"gravity_moment_1_{c}" for c in "xyz"]
    parts = []
    for c in range(3):
        across = np.eye(3)[c] - axis[c] * axis
        column = tuple(product for k in range(3) if abs(across[k]) > 1e-9 for product in linear(moment[k], float(across[k])))
        if column:
            parts.append(DescribedPart("frame", 1, 3 + c, (column,)))
    report = scalar_report("compliance_rad_per_Nm")
    return [
        Candidate(
            NAME, ("link1",), "gravity_torque_2", built(context, parts), report, np.array([1e-7]), positive=True, described=lambda _: parts
        )
    ]
