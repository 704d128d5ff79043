"""A bias of the scanner right after switching on, which fades with time; offset_mm is its size at the first pose."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, number, vector
from mbcacq.effects.functions import ZERO, DescribedPart, of
from mbcacq.effects.pose import warm_up

NAME = "scanner_warmup"
UNCERTAIN_TAU = 2.0  # growth of the variance of the offset, because the time constant is estimated with it


def candidates(context: Context) -> list[Candidate]:
    """One candidate: three offsets in mm, and a time constant to be found."""
    hyper, functions = warm_up.time_constant(context), warm_up.fading(context)

    def build(tau):
        fade = functions(np.array([tau]))[0][context.obs.pose]
        return [Part("point", 0, c, fade * np.eye(3)[c]) for c in range(3)]

    def report(c, v, tau):
        return {"offset_mm": vector(c, UNCERTAIN_TAU * v), "time_constant_s": number(tau, warm_up.time_constant_std(tau, c, v))}

    def described(tau):
        fade = of("time", "decay", tau)
        return [DescribedPart("point", 0, c, (ZERO,) * c + (fade,) + (ZERO,) * (2 - c)) for c in range(3)]

    return [
        Candidate(
            NAME,
            ("scanner",),
            "time",
            build,
            report,
            np.full(3, 0.02),
            hyper,
            tuple(("point", 0, c) for c in range(3)),
            functions,
            described=described,
        )
    ]
