"""The map as pictures show it: every place by every covariate, and how improbable it is that chance explains as much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_atlas import EvidenceMap
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring


@dataclass(frozen=True)
class MapEntry:
    """One cell of the map. log10_p: of the evidence for it, corrected for the number of places and shapes there."""

    at: str
    depends_on: str
    gain: float
    log10_p: float


def mismatch(screen: CandidateScoring, chart: DesignBlocks) -> list[MapEntry]:
    """All cells of the map beyond what the screen has projected out, most significant first."""
    cells = EvidenceMap(screen, chart).judge(screen).cells
    return sorted((MapEntry(c.at, c.depends_on, c.gain, min(-c.weighed / np.log(10), 0.0)) for c in cells), key=lambda p: p.log10_p)


def log10_tail(gain: float, k: int) -> float:
    """log10 of the probability that chance alone gains as much."""
    tail = chi2.logsf(max(gain, 0.0), k)
    if not np.isfinite(tail):  # first term of the asymptotic series
        tail = (k / 2 - 1) * np.log(gain / 2) - gain / 2 - gammaln(k / 2)
    return float(tail / np.log(10))
