"""A bias of the scanner by incidence: the more the artefact leans away, the more its centres come out too deep and to the side."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, plain_effect
from mbcacq.effects.functions import ZERO, DescribedPart, monomial

NAME = "incidence_bias"
DECLARED = Declaration(challenge=Challenge(number=20))
TYPICAL = 0.1  # mm at grazing incidence, of a squared sine
LEAST = 0.02  # of the squared sine of the incidence, range over the poses


def candidates(context: Context) -> list[Candidate]:
    """By the squared sine of the angle between the scanner's axis and the artefact's normal: along z, and across along the lean too."""
    if not context.scanner_on_flange or np.ptp(context.obs.xyz, axis=0).max() == 0:
        raise Missing("no incidence: the measured points are all at one place, or not a scanner's")
    if np.ptp(1 - context.value("lean_z") ** 2) < LEAST:
        raise Missing("the artefact leans alike in all poses")
    sine2 = (monomial(), monomial(-1.0, lean_z=2))
    side = {c: (monomial(**{f"lean_{c}": 1}), monomial(-1.0, lean_z=2, **{f"lean_{c}": 1})) for c in "xy"}
    lean = {c: (monomial(**{f"lean_{c}": 1}),) for c in "xy"}
    ways = [("depth", [DescribedPart("point", 0, 2, (sine2,))], ["depth_mm"])]
    for variant, across in (("", side), ("linear", lean)):
        columns = ((ZERO, across["x"]), (ZERO, across["y"]), (sine2, ZERO))
        ways.append((variant, [DescribedPart("point", 0, c, columns[c]) for c in range(3)], ["depth_mm", "side_mm"]))
    return [plain_effect(NAME, ["scanner"], "tilt", parts, dict.fromkeys(names, TYPICAL), variant=way) for way, parts, names in ways]
