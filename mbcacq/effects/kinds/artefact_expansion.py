"""An artefact that is not at its reference temperature, or whose certificate is off by a scale."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, Support, plain_effect
from mbcacq.effects.functions import DescribedPart, of

NAME = "artefact_expansion"
# Aluminium, which grows most of what artefacts are made of, 24 ppm a kelvin (steel: 12); lengths are certified for 20 degrees (ISO 1), and
# machines work from 5 to 40 degrees (IEC 60204-1): 20 K at most.
LARGEST = Support(24 * 20, "no artefact is off by more than 480 ppm by its temperature, aluminium at 40 °C")  # ppm
DECLARED = Declaration(challenge=Challenge(number=15))


def candidates(context: Context) -> list[Candidate]:
    """For each artefact of two or more measured balls, a scale of its centres about their mean."""
    cell, out = context.obs.cell, []
    if not context.scanner_on_flange:
        raise Missing("no artefact with several balls")
    owner, centres = cell.ball_artefact, cell.ball_centres
    for a, artefact in enumerate(cell.artefacts):
        mine = np.flatnonzero(owner == a)
        if len(mine) < 2 or not np.any(np.isin(context.obs.ball, mine)):
            continue
        from_mean = centres - centres[mine].mean(axis=0)
        grown = [tuple(one for k in mine for one in of("ball", "is", cell.ball_ids[k], factor=1e-6 * from_mean[k, c])) for c in range(3)]
        parts = [DescribedPart("ball", 0, c, (grown[c],)) for c in range(3)]
        out.append(plain_effect(NAME, [artefact.id], "x", parts, {"scale_ppm": 100.0}, support=LARGEST))
    if not out:
        raise Missing("no artefact with two balls seen")
    return out
