"""Whether what parametric effects leave of a long recording is noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapCell, MapEvidence
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring

STRUCTURE = float(np.log(100.0))  # log Bayes factor of the map from which there is structure: a false alarm at most once in a hundred


@dataclass(frozen=True)
class ResidualTests:
    """evidence: the map of the residual. centres: number tested."""

    evidence: MapEvidence
    centres: int

    @property
    def structure(self) -> bool:
        return self.evidence.total > STRUCTURE

    @property
    def significant_cells(self) -> list[MapCell]:
        """The best cell of every location that is significant by itself, most significant first; where none is, the best cell of all."""
        least = STRUCTURE + np.log(len(self.evidence.locations))
        best = [location for location, log in self.evidence.locations.items() if log > least] or list(self.evidence.locations)[:1]
        return [self.evidence.cell(self.evidence.best_at(location)) for location in best]


def examine_residual(projected: CandidateScoring, evidence_map: EvidenceMap) -> ResidualTests:
    """projected: conditioned on everything that has been found; evidence_map: of the same noise."""
    return ResidualTests(evidence_map.evaluate(projected), int(projected.linear.keep.sum()))
