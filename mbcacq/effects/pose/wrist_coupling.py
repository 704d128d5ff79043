"""Motion of one wrist axis that leaks into another, as through hollow shafts whose compensation is wrong."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, scalar_report
from mbcacq.effects.functions import DescribedPart, linear

NAME = "wrist_coupling"
DECLARED = Declaration(between_locations=True, challenge=Challenge(number=7))


def candidates(context: Context) -> list[Candidate]:
    """For each ordered pair of wrist axes, the angle of the second by that of the first."""
    first = max(context.n - 3, 0)
    pairs = [(i, j) for i in range(first, context.n) for j in range(first, context.n) if i != j and np.ptp(context.obs.q[:, i]) > 0.02]
    out = []
    for i, j in pairs:
        parts = [DescribedPart("joint", j, 0, (linear(f"q{i + 1}"),))]
        where, report, typical = (f"A{i + 1}", f"A{j + 1}"), scalar_report("ratio"), np.array([1e-4])
        out.append(Candidate(NAME, where, f"q{i + 1}", parts, report, typical))
    return out
