"""A bias of a target's measured orientation by the direction from which the instrument beside the arm sees it.

A camera finds the orientation of a target from its markers; the error depends on how these lie in the picture. A constant error is the
hand-eye transform's, so the turn is a polynomial of the line of sight in the target's axes without a constant. It is of first degree, or
consists of all polynomials of second degree on the sphere.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Declaration
from mbcacq.effects.effect import Candidate, Missing, ParameterEstimate, StandstillRows, number
from mbcacq.effects.functions import INCIDENCE, ZERO, DescribedPart, evaluate, of_second_degree

NAME = "orientation_bias"
DECLARED = Declaration(same_as_group=True)
TYPICAL = 1e-4  # rad, for a line of sight that turns by one rad
LEAST = 0.02  # range of a component of the line of sight


def candidates(context: Context) -> list[Candidate]:
    """A turn about each of the target's axes, of first and of second degree in the line of sight."""
    if np.ptp(context.incidence, axis=0).max() < LEAST:
        raise Missing("the instrument sees the target from one direction")

    out = []
    whole = of_second_degree(INCIDENCE)
    for variant, columns in (("linear", whole[:3]), ("", whole)):
        f = len(columns)
        parts = [DescribedPart("orientation", 0, c, (ZERO,) * (c * f) + columns + (ZERO,) * ((2 - c) * f)) for c in range(3)]
        functions = evaluate(columns, context.value, context.obs.n_centres)
        centred = functions - functions.mean(axis=0)
        typical = np.full(3 * f, TYPICAL)

        def report(c, v, _, centred=centred):
            each = np.arange(len(c)).reshape(3, -1)
            return {f"about_{axis}_rad": turned(centred, c[own], v[np.ix_(own, own)]) for axis, own in zip("xyz", each, strict=True)}

        out.append(Candidate(NAME, ("target",), "incidence", StandstillRows(parts, typical), report, variant=variant))
    return out


def turned(functions: np.ndarray, c: np.ndarray, covariance: np.ndarray) -> ParameterEstimate:
    """Root mean square over the recording of a turn by functions (M, f), without its mean, and its standard deviation; c: (f,)."""
    turn = functions @ c
    size = float(np.sqrt(np.mean(turn**2)))
    slope = functions.T @ turn / (len(turn) * max(size, 1e-300))
    return number(size, float(np.sqrt(slope @ covariance @ slope)))
