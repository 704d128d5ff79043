"""The zero of a joint moves with a recorded temperature: encoder, bearing and housing warm up, and not all of them alike."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, Support, plain_effect
from mbcacq.effects.functions import DescribedPart, Function, Product

NAME = "thermal_zero_shift"
# Aluminium grows by 24e-6 of its length a kelvin: the head of an encoder at the end of a bracket, or one side of a housing that is warmer
# than the other, moves by that over a radius no longer than a quarter of the bracket.
LARGEST = Support(1e-4, "the zero of a joint moves by no more than 0.1 mrad a kelvin")
TYPICAL = 5e-6  # rad/K: 50 um at a metre when an arm has warmed up by 10 K
STRONGEST = 4.0  # times a simulated bracket of 12 mm beside a disc of 15 mm: no more than the bound
DECLARED = Declaration(acts_in_time=True, needs=("temperature",), challenge=Challenge(number=24, strongest=STRONGEST))


def candidates(context: Context) -> list[Candidate]:
    """For each joint, the turn of its zero with each temperature that varies, in rad/K."""
    recorded = {name: values for name, values in context.obs.temperatures.items() if np.ptp(values) > 0.2}
    if not recorded:
        raise Missing("no temperatures recorded")
    out = []
    for name, values in recorded.items():
        change = (Product(1.0, (Function(name),)), Product(-float(values[np.argmin(context.order)])))
        for i in range(context.n):
            part = DescribedPart("joint", i, 0, (change,))
            out.append(plain_effect(NAME, [context.axes[i]], name, [part], {f"{context.axes[i]}.zero_rad_per_K": TYPICAL}, support=LARGEST))
    return out
