"""A joint that turns a little more or less than reported: encoder or gear ratio. ``ratio`` is the excess over 1."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, scalar_report

NAME = "joint_scale"


def candidates(s: Context) -> list[Candidate]:
    return [
        Candidate(
            NAME,
            (f"A{i + 1}",),
            f"q{i + 1}",
            lambda _, i=i: [Part("joint", i, 0, s.obs.q[:, i : i + 1])],
            scalar_report(f"A{i + 1}.ratio"),
            np.array([1e-4]),
        )
        for i in range(s.n)
        if np.ptp(s.obs.q[:, i]) > 0.02
    ]
