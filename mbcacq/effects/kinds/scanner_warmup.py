"""A bias of the scanner right after switching on, which fades with time; offset_mm is its size at the first pose."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, StandstillRows, number, vector
from mbcacq.effects.functions import ZERO, DescribedPart, of
from mbcacq.effects.over_time import time_constant, time_constant_std

NAME = "scanner_warmup"
DECLARED = Declaration(acts_in_time=True, needs=("time_s",), challenge=Challenge(number=13))
UNCERTAIN_TAU = 2.0  # growth of the variance of the offset, because the time constant is estimated with it


def candidates(context: Context) -> list[Candidate]:
    """One candidate: three offsets in mm, and a time constant to be found."""
    hyper = time_constant(context)

    def report(c, v, tau):
        return {"offset_mm": vector(c, UNCERTAIN_TAU * v), "time_constant_s": number(tau.value, time_constant_std(tau.value, c, v))}

    def described(tau):
        fade = of("time", "decay", tau)
        return [DescribedPart("point", 0, c, (ZERO,) * c + (fade,) + (ZERO,) * (2 - c)) for c in range(3)]

    return [Candidate(NAME, ("scanner",), "time", StandstillRows(described, np.full(3, 0.02)), report, hyper)]
