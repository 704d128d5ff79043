"""A joint that turns a little more or less than reported: encoder or gear ratio. ``ratio`` is the excess over 1."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, scalar_report

NAME = "joint_scale"


def candidates(context: Context) -> list[Candidate]:
    """For each joint that moves, the excess of its ratio over 1."""
    return [
        Candidate(
            NAME,
            (f"A{i + 1}",),
            f"q{i + 1}",
            lambda _, i=i: [Part("joint", i, 0, context.obs.q[:, i : i + 1])],
            scalar_report(f"A{i + 1}.ratio"),
            np.array([1e-4]),
        )
        for i in range(context.n)
        if np.ptp(context.obs.q[:, i]) > 0.02
    ]
