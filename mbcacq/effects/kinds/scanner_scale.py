"""An error of the scanner's unit of length, the same along all axes or different along each."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, StandstillRows, Support, plain_report, vector
from mbcacq.effects.functions import ZERO, DescribedPart, linear

NAME = "scanner_scale"
# The base of a triangulating scanner grows by some 1e-5 a kelvin, and its makers state 1e-3 and less; one that is off by 1 % reports
# another unit.
LARGEST = Support(1e4, "a scanner that is off by more than 1 % reports another unit")  # ppm
DECLARED = Declaration(challenge=Challenge(number=11))


def candidates(context: Context) -> list[Candidate]:
    """One scale, three scales, and the scale of each axis alone, in parts per million."""
    if not context.scanner_on_flange or np.ptp(context.obs.xyz, axis=0).max() == 0:
        raise Missing("no field of view: the measured points are all at one place, or not a scanner's")
    shift = [linear(axis, 1e-6) for axis in "xyz"]
    one = [DescribedPart("point", 0, c, (shift[c],)) for c in range(3)]
    three = [DescribedPart("point", 0, c, (ZERO,) * c + (shift[c],) + (ZERO,) * (2 - c)) for c in range(3)]

    def candidate(parts: list[DescribedPart], cause: str, variant: str, along: np.ndarray) -> Candidate:
        """along: (3, k): the scale of each axis by the coefficients."""
        rows = StandstillRows(parts, np.full(along.shape[1], 200.0))

        def report(c, v, _):
            return {"scale_ppm": vector(along @ c, along @ v @ along.T)}

        shown = report if variant else plain_report("scale_ppm")
        return Candidate(NAME, ("scanner",), cause, rows, shown, variant=variant, support=LARGEST)

    alone = [candidate([DescribedPart("point", 0, a, (shift[a],))], "xyz"[a], "xyz"[a], np.eye(3)[:, [a]]) for a in range(3)]
    return [candidate(one, "z", "", np.ones((3, 1))), candidate(three, "x", "axes", np.eye(3)), *alone]
