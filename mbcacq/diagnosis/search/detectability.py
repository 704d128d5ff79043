"""How well a recording sees each place of an effect, before it is searched.

Of an effect that could be at several joints, those where one of typical size could hardly be seen leave most of their share of chance, and
of what is probable beforehand, to the others: one found there would have to be many times as large as such effects are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.variance_components import MANY_POSES
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate

JUST = 4.0  # chi2 of an effect that can just be seen
LEAST = 0.1  # share of a place that sees nothing: sizes may be far from typical


def sighted(linear: LinearProblem, noise: NoiseEstimate, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, with the ``detectability`` of those of which all of the kind have one coefficient, and nothing else to be sought."""
    if linear.obs.n_poses > MANY_POSES:
        return list(candidates)  # all is seen
    screen = CandidateScoring(linear, noise)
    others = {c.name for c in candidates if c.k > 1 or c.hyper is not None}
    return [c if c.name in others else replace(c, detectability=share(screen, c)) for c in candidates]


def share(screen: CandidateScoring, candidate: Candidate) -> float:
    """LEAST to 1, by the chi2 that the candidate makes at its typical size beyond what geometry could take."""
    _, information, _ = screen.prepared(candidate, None)
    seen = float(information[0, 0]) * candidate.typical[0] ** 2
    return float(np.clip((seen + LEAST * JUST) / (seen + JUST), LEAST, 1.0))
