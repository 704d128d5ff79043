"""A bias of a target's measured orientation by the direction from which the instrument beside the arm sees it.

A camera finds the orientation of a target from its markers; the error depends on how these lie in the picture. A constant error is the
hand-eye transform's, so the turn is a polynomial of the line of sight in the target's axes without a constant: of first degree, or all
polynomials of second degree on the sphere.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.covariates import INCIDENCE
from mbcacq.effects.described import built
from mbcacq.effects.effect import Candidate, Missing, vector
from mbcacq.effects.functions import ZERO, DescribedPart, of_second_degree

NAME = "orientation_bias"
TYPICAL = 1e-4  # rad, for a line of sight that turns by one rad
LEAST = 0.02  # range of a component of the line of sight


def candidates(context: Context) -> list[Candidate]:
    """A turn about each of the target's axes, of first and of second degree in the line of sight."""
    if np.ptp(context.incidence, axis=0).max() < LEAST:
        raise Missing("the instrument sees the target from one direction")

    def report(c, v, _):
        each = np.arange(len(c)).reshape(3, -1)
        return {f"about_{axis}_rad": vector(c[own], v[np.ix_(own, own)]) for axis, own in zip("xyz", each, strict=True)}

    out = []
    whole = of_second_degree(INCIDENCE)
    for variant, columns in (("linear", whole[:3]), ("", whole)):
        f = len(columns)
        parts = [DescribedPart("orientation", 0, c, (ZERO,) * (c * f) + columns + (ZERO,) * ((2 - c) * f)) for c in range(3)]
        build = built(context, parts)
        out.append(
            Candidate(
                NAME, ("target",), "incidence", build, report, np.full(3 * f, TYPICAL), variant=variant, described=lambda _, d=parts: d
            )
        )
    return out
