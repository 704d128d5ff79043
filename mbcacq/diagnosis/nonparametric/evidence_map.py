"""Evidence map of unmodelled effects: every location by every shape, by its Bayes factor beyond geometry and whatever is conditioned on.

Every shape at every choice of a location's components is a block of a normal matrix, of which only these blocks are made; those of one
size stand in one array. Conditioning on an effect or a group is a correction of low rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction
from mbcacq.diagnosis.nonparametric.bayes_factor import log_bayes_factor, log_mean
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, BlockPlan, DesignBlocks, GivenBlocks
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring

Normal = tuple[list[np.ndarray], np.ndarray, np.ndarray]  # of each block S (H, k, k); b and raw squares of all columns of the group


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
    """cells: best first, one for each (location, depends_on). locations: location -> log of its mean Bayes factor, best first. total: log
    of the mean over all locations.
    """

    cells: list[MapCell]
    locations: dict[str, float]
    total: float

    def best(self) -> MapCell:
        """The best cell of the best location."""
        return self.best_at(next(iter(self.locations)))

    def best_at(self, location: str) -> MapCell:
        return next(c for c in self.cells if c.location == location)


class EvidenceMap:
    """Of one recording under one noise model, prepared with geometry alone projected out."""

    def __init__(self, projected: CandidateScoring, design_blocks: DesignBlocks | GivenBlocks):
        self.projected, self.design_blocks = projected, design_blocks
        self.whitened: dict[int, np.ndarray] = {}  # of groups that are functions of the centre
        self.normal = [self._normal(group, plan) for group, plan in zip(design_blocks.groups, design_blocks.plans, strict=True)]

    def _normal(self, group: BlockGroup, plan: BlockPlan) -> Normal:
        projected = self.projected
        if not group.per_pose:
            X = self._whitened(group)
            absorbed = (projected.Q.T @ X).T
            full, b = X.T @ X, X.T @ projected.beyond_geometry()
            blocks = [full[block.index[:, :, None], block.index[:, None]] for block in plan.blocks]
            return projected_out(blocks, plan, absorbed), b, np.diag(full).copy()
        b, A, C = projected.pose_products(group.keys)
        U, mix = group.functions, group.mix
        b, A = b @ mix.T, mix @ A @ mix.T
        products = A.reshape(len(A), -1).T @ plan.products
        blocks = [products[block.components, block.functions] for block in plan.blocks]
        own = np.diagonal(A, axis1=1, axis2=2)
        return projected_out(blocks, plan, by_functions(group, C)), (U.T @ b).T.reshape(-1), (own.T @ (U * U)).reshape(-1)

    def _whitened(self, group: BlockGroup) -> np.ndarray:
        key = id(group)
        if key not in self.whitened:
            rows, functions = np.arange(group.components), np.arange(group.functions.shape[1])
            # With the group itself, so that no other one gets its identity.
            _, columns = self.projected.linear.computed_once(("group", key), lambda: (group, self._columns(group, rows, functions)))
            self.whitened[key] = self.projected.whiten(columns)
        return self.whitened[key]

    def _columns(self, group: BlockGroup, rows: np.ndarray, index: np.ndarray) -> np.ndarray:
        """(M, R, rows x index), component-major."""
        linear = self.projected.linear
        unit = np.stack([linear.unit(*key) for key in group.keys], axis=2) @ group.mix[rows].T
        F = group.functions[:, index]
        F = F[linear.obs.pose] if group.per_pose else F
        return (unit[:, :, :, None] * F[:, None, None, :]).reshape(*unit.shape[:2], -1)

    def evaluate(self, projected: CandidateScoring) -> MapEvidence:
        """projected: this map's problem, possibly conditioned on effects and groups."""
        cells: dict[tuple[str, str], MapCell] = {}
        by_location: dict[str, list[float]] = {}
        for number, (group, plan) in enumerate(zip(self.design_blocks.groups, self.design_blocks.plans, strict=True)):
            S, b, raw = self.normal[number]
            if projected.conditioned.shape[1]:
                absorbed = self._conditioned(group, projected)
                S, b = projected_out(S, plan, absorbed), b - absorbed @ projected.along
            self._add_evidence(number, (S, b, raw), cells, by_location)
        count = np.log(len(by_location))
        mean = {location: log_mean(np.array(logs)) for location, logs in by_location.items()}
        ranked = dict(sorted(mean.items(), key=lambda item: -item[1]))
        total = float(np.logaddexp.reduce(list(mean.values())) - count)
        return MapEvidence(sorted(cells.values(), key=lambda c: -c.log_bayes_factor), ranked, total)

    def entry_evidence(self, projected: CandidateScoring) -> list[np.ndarray]:
        """Of each group, the log Bayes factor of every entry beyond what a problem is conditioned on."""
        out = []
        for group, plan, (S, b, raw) in zip(self.design_blocks.groups, self.design_blocks.plans, self.normal, strict=True):
            if projected.conditioned.shape[1]:
                absorbed = self._conditioned(group, projected)
                S, b = projected_out(S, plan, absorbed), b - absorbed @ projected.along
            logs = np.zeros(len(group.entries))
            for block, own in zip(plan.blocks, S, strict=True):
                logs[block.entries] = log_bayes_factor(own, b[block.index], raw[block.index], block.weight)[0]
            out.append(logs)
        return out

    def _conditioned(self, group: BlockGroup, projected: CandidateScoring) -> np.ndarray:
        """(k, a) products of the group's columns with the basis of what the problem is conditioned on."""
        if not group.per_pose:
            return self._whitened(group).T @ projected.conditioned
        return by_functions(group, projected.conditioned_pose_products(group.keys))

    def _add_evidence(
        self, number: int, normal: Normal, cells: dict[tuple[str, str], MapCell], by_location: dict[str, list[float]]
    ) -> None:
        """Bayes factors of all blocks of a group: all of them by location, and the best cell of each location and covariate."""
        group, (S, b, raw) = self.design_blocks.groups[number], normal
        for block, own in zip(self.design_blocks.plans[number].blocks, S, strict=True):
            logs, gains, used = log_bayes_factor(own, b[block.index], raw[block.index], block.weight)
            names = [group.entries[e][0] for e in block.entries]
            for name in dict.fromkeys(names):
                by_location.setdefault(name, []).extend(logs[[j for j, other in enumerate(names) if other == name]])
            for j in best_entries(group, block.entries, logs):
                location, rows, shape = group.entries[block.entries[j]]
                log, key = float(logs[j]), (location, shape.depends_on)
                posterior = log - self.design_blocks.log_prior_shares[location]
                if key not in cells or log > cells[key].log_bayes_factor:
                    cells[key] = MapCell(*key, log, posterior, float(gains[j]), float(used[j]), number, rows, shape)

    def random_effect(self, cell: MapCell) -> RandomEffect:
        """The cell's columns, each of unit size (or zero, where these data do not determine it), as a random effect."""
        group = self.design_blocks.groups[cell.group]
        f, rows = group.functions.shape[1], np.array(cell.rows)
        columns = self._columns(group, rows, cell.shape.index)
        raw = self.normal[cell.group][2][(rows[:, None] * f + cell.shape.index).reshape(-1)]
        weight = np.tile(cell.shape.weight, len(rows))
        return RandomEffect(cell.location, cell.depends_on, columns / np.sqrt(np.maximum(raw, 1e-200)), weight)


def best_entries(group: BlockGroup, entries: list[int], logs: np.ndarray) -> list[int]:
    """Of the entries of a block, the numbers of those with the largest log Bayes factor at each location and covariate."""
    best: dict[tuple[str, str], int] = {}
    for j, e in enumerate(entries):
        key = group.entries[e][0], group.entries[e][2].depends_on
        if key not in best or logs[j] > logs[best[key]]:
            best[key] = j
    return list(best.values())


def by_functions(group: BlockGroup, C: np.ndarray) -> np.ndarray:
    """(columns of the group, z): sums over the poses of its functions times C (P, c, z)."""
    C = group.mix @ C
    P, c, z = C.shape
    f = group.functions.shape[1]
    return (group.functions.T @ C.reshape(P, -1)).reshape(f, c, z).transpose(1, 0, 2).reshape(c * f, z)


def projected_out(blocks: list[np.ndarray], plan: BlockPlan, absorbed: np.ndarray) -> list[np.ndarray]:
    """Blocks (H, k, k) less what a projection absorbs: absorbed (columns, z)."""
    out = []
    for S, block in zip(blocks, plan.blocks, strict=True):
        T = absorbed[block.index]
        out.append(S - T @ np.swapaxes(T, 1, 2))
    return out


def map_entries(projected: CandidateScoring, design_blocks: DesignBlocks) -> list[MapEntry]:
    """All cells of the map beyond what is projected out, most significant first."""
    cells = EvidenceMap(projected, design_blocks).evaluate(projected).cells
    entries = (MapEntry(c.location, c.depends_on, c.gain, min(-c.log_posterior / np.log(10), 0.0)) for c in cells)
    return sorted(entries, key=lambda p: p.log10_p)


def log10_tail(gain: float, k: int) -> float:
    """log10 of the probability that noise alone gains as much with k coefficients."""
    tail = chi2.logsf(max(gain, 0.0), k)
    if not np.isfinite(tail):  # first term of the asymptotic series
        tail = (k / 2 - 1) * np.log(gain / 2) - gain / 2 - gammaln(k / 2)
    return float(tail / np.log(10))
