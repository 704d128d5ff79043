"""Clearance of the mount: a scanner that is loose falls from one seat to the other as the flange turns over."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, Missing, Parameters, StandstillRows, vector
from mbcacq.effects.functions import DescribedPart, of

NAME = "mount_clearance"
DECLARED = Declaration(challenge=Challenge(number=23))
FEWEST = 4  # poses in the rarer seat
# (azimuth, elevation) in flange axes of the line along which gravity closes the clearance; the opposite direction is the same line.
LINES = [
    *((azimuth, 0) for azimuth in range(0, 180, 30)),
    *((azimuth, 30) for azimuth in range(0, 360, 30)),
    *((azimuth, 60) for azimuth in range(0, 360, 60)),
    (0, 90),
]
FALLS = np.array([-0.25, -0.1, 0.0, 0.1, 0.25])  # component of gravity along the line where it changes seats: friction holds it
AT_ONCE = 1e-6  # of that component, over which a hyperbolic tangent is a sign


def candidates(context: Context) -> list[Candidate]:
    """For each of the lines a shift (mm) and, where the measurement shows it, a turn (rad), half of the way between both seats."""
    components = range(6) if context.scanner_on_flange or context.obs.rotation is not None else range(3)
    typical = np.array([0.03] * 3 + [1e-4] * 3)[: len(components)]
    out = []
    for azimuth, elevation in LINES:
        cause = f"gravity_along_{context.n}_{azimuth}_{elevation}"
        along = context.value(cause)
        values = np.array([at for at in FALLS if min(np.sum(along > at), np.sum(along < at)) >= FEWEST])
        if len(values):
            out.append(_along(context, cause, components, values, typical))
    if not out:
        raise Missing("the flange is never turned over")
    return out


def _along(context: Context, cause: str, components: range, values: np.ndarray, typical: np.ndarray) -> Candidate:
    def described(at: float) -> list[DescribedPart]:
        seat = of(cause, "sigmoid", at, AT_ONCE)
        return [DescribedPart("frame", context.n, c, ((),) * c + (seat,) + ((),) * (len(components) - 1 - c)) for c in components]

    def report(c: np.ndarray, v: np.ndarray, at: HyperEstimate) -> Parameters:
        out = {"shift_mm": vector(2 * c[:3], 4 * v[:3, :3])}
        return out | {"turn_deg": vector(np.degrees(2 * c[3:]), np.degrees(np.degrees(4 * v[3:, 3:])))} if len(c) == 6 else out

    hyper, rarity = Hyperparameter("falls_at", values, 2.0, refine=False), 1.0 / len(LINES)
    return Candidate(NAME, ("mount",), cause, StandstillRows(described, typical), report, hyper, variant=cause, rarity=rarity)
