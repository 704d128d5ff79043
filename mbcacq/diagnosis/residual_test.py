"""Does what is left look like noise? Smooth and periodic functions of everything, neighbours, and pose-wise size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm

from mbcacq.diagnosis.locate import Spot, mismatch
from mbcacq.diagnosis.screen import Screen
from mbcacq.physics.situation import Situation

SIGNIFICANT = -2.3  # log10 of the corrected p-value of the map: one clean recording in two hundred


@dataclass(frozen=True)
class Leftover:
    """spots: the map of what is left; neighbours_p: of dependence between poses that are close in the joints; chi2_dof after."""

    spots: list[Spot]
    neighbours_p: float
    chi2_dof: float

    @property
    def structure(self) -> bool:
        return bool(self.spots and self.spots[0].log10_p < SIGNIFICANT) or self.neighbours_p < 1e-4

    @property
    def significant(self) -> list[Spot]:
        return [p for p in self.spots if p.log10_p < SIGNIFICANT]


def examine(screen: Screen, s: Situation) -> Leftover:
    return Leftover(mismatch(screen, s), neighbour_dependence(screen, s), screen.chi2 / max(screen.dof, 1.0))


def neighbour_dependence(screen: Screen, s: Situation) -> float:
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
