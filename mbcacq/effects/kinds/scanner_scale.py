"""An error of the scanner's unit of length, the same along all axes or different along each."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, Report, StandstillRows, Support, number, vector
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

    def report_one(c, v, _):
        return {"scale_ppm": number(c[0], np.sqrt(v[0, 0]))}

    def report_three(c, v, _):
        return {"scale_ppm": vector(c, v)}

    def report_axis(axis: int) -> Report:
        only = np.eye(3)[axis]
        return lambda c, v, _: {"scale_ppm": vector(c[0] * only, v[0, 0] * np.diag(only))}

    def candidate(parts: list[DescribedPart], cause: str, report: Report, k: int, variant: str) -> Candidate:
        typical = np.full(k, 200.0)
        return Candidate(NAME, ("scanner",), cause, StandstillRows(parts, typical), report, variant=variant, support=LARGEST)

    return [
        candidate(one, "z", report_one, 1, ""),
        candidate(three, "x", report_three, 3, "axes"),
        *(candidate([DescribedPart("point", 0, a, (shift[a],))], "xyz"[a], report_axis(a), 1, "xyz"[a]) for a in range(3)),
    ]
