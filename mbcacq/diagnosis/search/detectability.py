"""Detectability: how well a recording shows an effect at each of its locations, before it is searched.

Of an effect that could be at several joints, those where one of typical size could hardly be detected leave most of their share of the
false-alarm rate, and of the prior probability, to the others: one found there would have to be many times as large as such effects are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise


def with_detectability(linear: LinearProblem, noise: Noise, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, with the ``detectability`` of those of which all of the kind have one coefficient and no hyper-parameter."""
    if linear.obs.n_poses > OPTIONS.many_poses:
        return list(candidates)  # everything is detectable
    projected = CandidateScoring.of(linear, noise)
    others = {c.name for c in candidates if c.k > 1 or c.hyper is not None}
    return [c if c.name in others else replace(c, detectability=detectability(projected, c)) for c in candidates]


def detectability(projected: CandidateScoring, candidate: Candidate) -> float:
    """Between the least and 1, by the chi2 that the candidate makes at its typical size beyond what geometry could absorb."""
    _, information, _ = projected.candidate_products(candidate, None)
    chi2, just, least = float(information[0, 0]) * candidate.typical[0] ** 2, OPTIONS.detectable_chi2, OPTIONS.least_detectability
    return float(np.clip((chi2 + least * just) / (chi2 + just), least, 1.0))
