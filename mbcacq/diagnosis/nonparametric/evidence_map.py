"""Evidence map of unmodelled effects: every location by every shape, by its Bayes factor beyond geometry and whatever is conditioned on.

Every shape at every choice of a location's components is a block of a normal matrix, of which only these blocks are made; those of one
size, of all locations, stand in one array. Conditioning on an effect or a group is a correction of low rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, gammaln

from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction
from mbcacq.diagnosis.nonparametric.bayes_factor import log_bayes_factor, log_mean
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, DesignBlocks, GivenBlocks
from mbcacq.diagnosis.search.candidate_scoring import ROUNDING, CandidateScoring


@dataclass(frozen=True)
class MapCell:
    """One design block of the map. log_posterior: log Bayes factor plus the log of its prior share. gain in chi2; used: coefficients that
    the data determine. group, rows, shape: which columns.
    """

    location: str
    depends_on: str
    log_bayes_factor: float
    log_posterior: float
    gain: float
    used: float
    group: int
    rows: tuple[int, ...]
    shape: BasisFunction


@dataclass(frozen=True)
class MapEntry:
    """A cell as pictures show it. log10_p: of the evidence for it, corrected for the number of locations and shapes there."""

    at: str
    depends_on: str
    gain: float
    log10_p: float


@dataclass(frozen=True)
class MapEvidence:
    """Of all B design blocks: log Bayes factor, gain in chi2 and number of determined coefficients (B,). locations: location -> log of its
    mean Bayes factor, best first. total: log of the mean over all locations.
    """

    design_blocks: DesignBlocks | GivenBlocks
    log_bayes_factor: np.ndarray
    gain: np.ndarray
    used: np.ndarray
    locations: dict[str, float]
    total: float

    @cached_property
    def cells(self) -> list[MapCell]:
        """The best block of each (location, covariate), best first."""
        found = last_of_each(self.design_blocks.layout.cell, self.log_bayes_factor)
        return [self._cell(int(b)) for b in found[np.argsort(-self.log_bayes_factor[found], kind="stable")]]

    def best(self) -> MapCell:
        """The best cell of the best location."""
        return self.best_at(next(iter(self.locations)))

    def best_at(self, location: str) -> MapCell:
        layout = self.design_blocks.layout
        here = np.flatnonzero(layout.location == layout.locations.index(location))
        return self._cell(int(here[self.log_bayes_factor[here].argmax()]))

    def _cell(self, block: int) -> MapCell:
        g, e = self.design_blocks.layout.members[block]
        location, rows, shape = self.design_blocks.groups[g].entries[e]
        log = float(self.log_bayes_factor[block])
        posterior = log - self.design_blocks.log_prior_shares[location]
        gain, used = float(self.gain[block]), float(self.used[block])
        return MapCell(location, shape.depends_on, log, posterior, gain, used, g, rows, shape)


class EvidenceMap:
    """Of one recording under one noise model, prepared with geometry alone projected out.

    Of all columns (K,) of all groups: b, raw squares; absorbed (K, z), their products with the basis of the geometry. S: normal matrices
    (H, k, k) of the blocks of each size.
    """

    def __init__(self, projected: CandidateScoring, design_blocks: DesignBlocks | GivenBlocks):
        self.projected, self.design_blocks = projected, design_blocks
        each = [self._products(g) for g in range(len(design_blocks.groups))]
        self.b, absorbed = (np.concatenate([one[j] for one in each]) for j in (0, 2))
        self.raw = np.concatenate([without_rounding(one[1]) for one in each])
        self.S = []
        for sized in design_blocks.layout.sizes:
            whole = [each[g][3][first, second] for g, first, second in sized.products]
            self.S.append(projected_out(np.concatenate(whole), absorbed[sized.index]))

    def _products(self, g: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """b, raw (k,) and absorbed (k, z) of a group, and the table of its products (see SizedBlocks)."""
        projected, group = self.projected, self.design_blocks.groups[g]
        if not group.per_pose:
            full = projected.whiten.gram(self._unit(g), group.functions, self.design_blocks.layout.connected[g])
            sums = self._by_centre(g, np.c_[projected.Q, projected.beyond_geometry()])
            return sums[:, -1], np.diag(full).copy(), sums[:, :-1], full
        b, A, C = projected.pose_products(group.keys)
        U, mix = group.functions, group.mix
        b, A = b @ mix.T, mix @ A @ mix.T
        own = np.diagonal(A, axis1=1, axis2=2)
        products = A.reshape(len(A), -1).T @ self.design_blocks.layout.pairs[g]
        return (U.T @ b).T.reshape(-1), (own.T @ (U * U)).reshape(-1), by_functions(group, C, projected.stations), products

    def _unit(self, g: int) -> np.ndarray:
        """(M, R, c) change of the prediction by each component of a group."""
        linear, group = self.projected.linear, self.design_blocks.groups[g]
        return linear.computed_once(
            (group.keys, group.mix.tobytes()), lambda: np.stack([linear.unit(*key) for key in group.keys], axis=2) @ group.mix.T
        )

    def _by_centre(self, g: int, whitened: np.ndarray) -> np.ndarray:
        """(k, z): products of the columns of a group of functions of the centre with whitened ones (rows, z)."""
        group = self.design_blocks.groups[g]
        back = np.swapaxes(self._unit(g), 1, 2) @ self.projected.whiten.transpose(whitened)
        return np.tensordot(group.functions, back, axes=(0, 0)).transpose(1, 0, 2).reshape(-1, whitened.shape[1])

    def evaluate(self, projected: CandidateScoring, least: float = -np.inf) -> MapEvidence:
        """projected: this map's problem, possibly conditioned on effects and groups. least: log Bayes factor below which that of a block
        need not be known; blocks that cannot reach it have none (-inf).
        """
        layout, b, absorbed = self.design_blocks.layout, self.b, None
        if projected.conditioned.shape[1]:
            absorbed = np.concatenate([self._conditioned(g, projected) for g in range(len(self.design_blocks.groups))])
            b = b - absorbed @ projected.along
        found = []
        for sized, S in zip(layout.sizes, self.S, strict=True):
            beyond = S if absorbed is None else projected_out(S, absorbed[sized.index])
            found.append(log_bayes_factor(beyond, b[sized.index], self.raw[sized.index], sized.weight, least))
        log, gain, used = (np.concatenate([one[j] for one in found]) for j in range(3))
        means = [log_mean(log[layout.location == j]) for j in range(len(layout.locations))]
        ranked = {layout.locations[j]: means[j] for j in np.argsort(-np.array(means), kind="stable")}
        total = float(np.logaddexp.reduce(means) - np.log(len(means)))
        return MapEvidence(self.design_blocks, log, gain, used, ranked, total)

    def entry_evidence(self, projected: CandidateScoring) -> list[np.ndarray]:
        """Of each group, the log Bayes factor of every entry beyond what a problem is conditioned on."""
        out = [np.zeros(len(group.entries)) for group in self.design_blocks.groups]
        for (g, e), log in zip(self.design_blocks.layout.members, self.evaluate(projected).log_bayes_factor, strict=True):
            out[g][e] = log
        return out

    def _conditioned(self, g: int, projected: CandidateScoring) -> np.ndarray:
        """(k, a) products of a group's columns with the basis of what the problem is conditioned on."""
        group = self.design_blocks.groups[g]
        if not group.per_pose:
            return self._by_centre(g, projected.conditioned)
        return by_functions(group, projected.conditioned_pose_products(group.keys))

    def raw_of(self, cell: MapCell) -> np.ndarray:
        """(k,) squares of a cell's columns before any projection."""
        f = self.design_blocks.groups[cell.group].functions.shape[1]
        own = (np.array(cell.rows)[:, None] * f + cell.shape.index).reshape(-1)
        return self.raw[self.design_blocks.layout.start[cell.group] + own]


def without_rounding(raw: np.ndarray) -> np.ndarray:
    """(k,) squares of a group's columns, with the largest in the place of those that are rounding: a turn of a bar about itself moves no
    ball, and its coefficient, in units of what it moves, could be anything.
    """
    largest = float(raw.max(initial=0.0))
    return np.where(raw > ROUNDING * largest, raw, largest)


def last_of_each(group: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Of each group (B,), the index of the largest value (B,)."""
    order = np.lexsort((value, group))
    return order[np.r_[np.flatnonzero(np.diff(group[order])), len(order) - 1]]


def projected_out(S: np.ndarray, absorbed: np.ndarray) -> np.ndarray:
    """Blocks (H, k, k) less what a projection absorbs of their columns (H, k, z)."""
    return S - absorbed @ np.swapaxes(absorbed, 1, 2)


def by_functions(group: BlockGroup, C: np.ndarray, stations: Sequence[np.ndarray] = ()) -> np.ndarray:
    """(columns of the group, z): sums over the poses of its functions times C (P, c, z).

    stations: the poses of each, where the first columns of C, six of each station, vanish at the poses of all others.
    """
    C = group.mix @ C
    c, z = C.shape[1:]
    functions, f, first = group.functions, group.functions.shape[1], 6 * len(stations)
    out = np.empty((c, f, z))
    out[:, :, first:] = np.tensordot(functions, C[:, :, first:], axes=(0, 0)).transpose(1, 0, 2)
    for j, poses in enumerate(stations):
        own = slice(6 * j, 6 * j + 6)
        out[:, :, own] = np.tensordot(functions[poses], C[poses, :, own], axes=(0, 0)).transpose(1, 0, 2)
    return out.reshape(c * f, z)


def map_entries(projected: CandidateScoring, design_blocks: DesignBlocks) -> list[MapEntry]:
    """All cells of the map beyond what is projected out, most significant first."""
    cells = EvidenceMap(projected, design_blocks).evaluate(projected).cells
    entries = (MapEntry(c.location, c.depends_on, c.gain, min(-c.log_posterior / np.log(10), 0.0)) for c in cells)
    return sorted(entries, key=lambda p: p.log10_p)


def log10_tail(gain: float, k: int) -> float:
    """log10 of the probability that noise alone gains as much with k coefficients."""
    tail = chdtrc(k, max(gain, 0.0))
    log = np.log(tail) if tail > 0 else (k / 2 - 1) * np.log(gain / 2) - gain / 2 - gammaln(k / 2)  # first term of the asymptotic series
    return float(log / np.log(10))
