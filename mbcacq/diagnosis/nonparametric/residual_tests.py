"""Tests of whether the residual is noise: the evidence map, and dependence between neighbouring poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapCell, MapEvidence
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context

STRUCTURE = float(np.log(100.0))  # log Bayes factor of the map from which there is structure: a false alarm at most once in a hundred
NEIGHBOURS = 1e-4


@dataclass(frozen=True)
class ResidualTests:
    """evidence: the map of the residual. neighbours_p: of dependence between poses that are close in the joints. centres: number tested."""

    evidence: MapEvidence
    neighbours_p: float
    centres: int

    @property
    def structure(self) -> bool:
        return self.evidence.total > STRUCTURE or self.neighbours_p < NEIGHBOURS

    @property
    def significant_cells(self) -> list[MapCell]:
        """The best cell of every location that is significant by itself, most significant first; where none is, the best cell of all."""
        least = STRUCTURE + np.log(len(self.evidence.locations))
        out = [self.evidence.best_at(location) for location, log in self.evidence.locations.items() if log > least]
        return out or [self.evidence.best()]


def examine_residual(projected: CandidateScoring, s: Context, evidence_map: EvidenceMap) -> ResidualTests:
    """projected: conditioned on everything that has been found; evidence_map: of the same noise."""
    return ResidualTests(evidence_map.evaluate(projected), neighbour_dependence(projected, s), int(projected.linear.keep.sum()))


def neighbour_dependence(projected: CandidateScoring, s: Context) -> float:
    """p-value of correlated joint-space residuals of each pose and its nearest neighbour of another station or moment.

    The residual of a pose is its least-squares joint displacement, whitened; under noise neighbours have nothing in common.
    """
    linear = projected.linear
    units = tuple(("joint", i, 0) for i in range(s.n))
    E = np.stack([projected.unit(key) for key in units], axis=1)
    products = projected.whiten.pose_products(E, np.concatenate([E, projected.r[:, None]], axis=1))
    A, b = products[:, :, :-1], products[:, :, -1]
    used = np.flatnonzero(np.einsum("pii->p", A) > 0)
    if len(used) < 40:
        return 1.0
    size = np.sqrt(np.maximum(np.einsum("pii->pi", A), 1e-12))
    z = (b / size)[used]
    z = (z - z.mean(axis=0)) / np.maximum(z.std(axis=0), 1e-12)
    from scipy.spatial import KDTree  # here, for the import is slow

    position = linear.obs.q[used]
    position = position / np.maximum(position.std(axis=0), 1e-9)
    nearest = np.asarray(KDTree(position).query(position, k=2)[1])[:, 1]
    pairs = {(min(i, j), max(i, j)) for i, j in enumerate(nearest)}
    i, j = np.array(sorted(pairs)).T
    apart = s.obs.station[used][i] != s.obs.station[used][j] if len(np.unique(s.obs.station)) > 4 else np.ones(len(i), bool)
    if apart.sum() < 20:
        return 1.0
    product = (z[i[apart]] * z[j[apart]]).sum(axis=0)
    strongest = np.max(product / np.sqrt(apart.sum()))
    return float(min(1.0, s.n * ndtr(-strongest)))
