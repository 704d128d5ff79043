"""Does what is left look like noise? The map of what has no name, and dependence between neighbouring poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm

from mbcacq.diagnosis.nonparametric.evidence_atlas import EvidenceMap, JudgedMap, MapCell
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context

STRUCTURE = float(np.log(100.0))  # log of the map's evidence ratio from which there is something: by chance at most once in a hundred
NEIGHBOURS = 1e-4


@dataclass(frozen=True)
class ResidualTests:
    """judged: the map of what is left. neighbours_p: of dependence between poses that are close in the joints. centres: looked at."""

    judged: JudgedMap
    neighbours_p: float
    centres: int

    @property
    def structure(self) -> bool:
        return self.judged.total > STRUCTURE or self.neighbours_p < NEIGHBOURS

    @property
    def places(self) -> list[MapCell]:
        """The best cell of every place that is significant by itself, most significant place first."""
        out = [self.judged.best_at(at) for at, log in self.judged.places.items() if log > STRUCTURE + np.log(len(self.judged.places))]
        return out or [self.judged.best()]


def examine(screen: CandidateScoring, s: Context, atlas: EvidenceMap) -> ResidualTests:
    """screen: with everything adopted that is no longer to be found; atlas: of the same noise."""
    return ResidualTests(atlas.judge(screen), neighbour_dependence(screen, s), int(screen.linear.keep.sum()))


def neighbour_dependence(screen: CandidateScoring, s: Context) -> float:
    """p-value of correlated joint-space residuals of each pose and its nearest neighbour of another station or moment.

    The residual of a pose is its least-squares joint displacement, whitened; under noise neighbours have nothing in common.
    """
    linear = screen.linear
    units = tuple(("joint", i, 0) for i in range(s.n))
    E = np.stack([screen.unit(key) for key in units], axis=1)
    b = screen.by_pose(E * screen.r[:, None])
    A = screen.by_pose(E[:, :, None] * E[:, None, :])
    used = np.flatnonzero(np.einsum("pii->p", A) > 0)
    if len(used) < 40:
        return 1.0
    size = np.sqrt(np.maximum(np.einsum("pii->pi", A), 1e-12))
    z = (b / size)[used]
    z = (z - z.mean(axis=0)) / np.maximum(z.std(axis=0), 1e-12)
    place = linear.obs.q[used]
    place = place / np.maximum(place.std(axis=0), 1e-9)
    _, index = cKDTree(place).query(place, k=2)
    pairs = {(min(i, j), max(i, j)) for i, j in enumerate(index[:, 1])}
    i, j = np.array(sorted(pairs)).T
    apart = s.obs.station[used][i] != s.obs.station[used][j] if len(np.unique(s.obs.station)) > 4 else np.ones(len(i), bool)
    if apart.sum() < 20:
        return 1.0
    product = (z[i[apart]] * z[j[apart]]).sum(axis=0)
    strongest = np.max(product / np.sqrt(apart.sum()))
    return float(min(1.0, s.n * norm.sf(strongest)))
