"""Motion of one wrist axis that leaks into another, as through hollow shafts whose compensation is wrong."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, scalar_report

NAME = "wrist_coupling"


def candidates(context: Context) -> list[Candidate]:
    """For each ordered pair of wrist axes, the angle of the second by that of the first."""
    first = max(context.n - 3, 0)
    pairs = [(i, j) for i in range(first, context.n) for j in range(first, context.n) if i != j and np.ptp(context.obs.q[:, i]) > 0.02]
    return [
        Candidate(
            NAME,
            (f"A{i + 1}", f"A{j + 1}"),
            f"q{i + 1}",
            lambda _, i=i, j=j: [Part("joint", j, 0, context.obs.q[:, i : i + 1])],
            scalar_report("ratio"),
            np.array([1e-4]),
        )
        for i, j in pairs
    ]
