"""One ball is not where its certificate says."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, StandstillRows, vector
from mbcacq.effects.functions import ZERO, DescribedPart, of

NAME = "ball_shift"
DECLARED = Declaration(challenge=Challenge(number=14))
TYPICAL = 0.02  # mm: a ball that was knocked, or a certificate that aged


def candidates(context: Context) -> list[Candidate]:
    """For each ball of an artefact of four or more, a shift (3,) in mm along the axes of the artefact."""
    if not context.scanner_on_flange:
        raise Missing("no artefact with several balls")
    cell = context.obs.cell
    owner = cell.ball_artefact
    out = []
    for k, ball in enumerate(cell.ball_ids):
        here = context.obs.ball == k
        if np.sum(owner == owner[k]) < 4 or here.sum() < 4:
            continue  # a few balls only make a length, which is artefact_expansion
        this = of("ball", "is", ball)
        parts = [DescribedPart("ball", 0, c, (ZERO,) * c + (this,) + (ZERO,) * (2 - c)) for c in range(3)]
        rows = StandstillRows(parts, np.full(3, TYPICAL))
        out.append(Candidate(NAME, (f"ball{ball}",), "x", rows, lambda c, v, _: {"shift_mm": vector(c, v)}))
    return out
