"""The map of what has no name: every place by every shape, weighed by its evidence beyond geometry and whatever is adopted.

Every shape at every choice of a place's components is a block of a normal matrix, of which only these blocks are made; those of one size
lie in one array. Adopting an effect or a group is a correction of low rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction
from mbcacq.diagnosis.nonparametric.bayes_factor import log_mean, log_ratio
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, BlockPlan, DesignBlocks
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring


@dataclass(frozen=True)
class MapCell:
    """One group of the map. log_ratio: of its evidence, and with the share of its prior in ``weighed``; gain in chi2; used: coefficients
    determined. layer, rows, shape: which columns.
    """

    at: str
    depends_on: str
    log_ratio: float
    weighed: float
    gain: float
    used: float
    layer: int
    rows: tuple[int, ...]
    shape: BasisFunction


@dataclass(frozen=True)
class JudgedMap:
    """cells: best first, one for each (at, depends_on). places: place -> log of its mean evidence, best first. total: log, over all."""

    cells: list[MapCell]
    places: dict[str, float]
    total: float

    def best(self) -> MapCell:
        """The best cell of the best place."""
        return self.best_at(next(iter(self.places)))

    def best_at(self, at: str) -> MapCell:
        return next(c for c in self.cells if c.at == at)


class EvidenceMap:
    """Of one situation under one screen (geometry alone, one noise)."""

    def __init__(self, screen: CandidateScoring, chart: DesignBlocks):
        self.screen, self.chart = screen, chart
        self.layers, self.shares = chart.layers, chart.shares
        self.base = [self._normal(layer, plan, screen) for layer, plan in zip(chart.layers, chart.plans, strict=True)]

    def _normal(self, layer: BlockGroup, plan: BlockPlan, screen: CandidateScoring):
        """Of each block S (H, k, k) with geometry projected out; b and raw of all columns of the layer."""
        if not layer.per_pose:
            X = self._whitened(layer)
            taken = (screen.Q.T @ X).T
            full, b = X.T @ X, X.T @ (screen.r0 - screen.Q @ (screen.Q.T @ screen.r0))
            blocks = [full[block.index[:, :, None], block.index[:, None]] for block in plan.blocks]
            return less(blocks, plan, taken), b, np.diag(full).copy()
        b, A, C = screen.reduced(layer.keys)
        U, mix = layer.functions, layer.mix
        b, A = b @ mix.T, mix @ A @ mix.T
        products = A.reshape(len(A), -1).T @ plan.products
        blocks = [products[block.components, block.functions] for block in plan.blocks]
        own = np.diagonal(A, axis1=1, axis2=2)
        return less(blocks, plan, self._by_functions(layer, C)), (U.T @ b).T.reshape(-1), (own.T @ (U * U)).reshape(-1)

    @staticmethod
    def _by_functions(layer: BlockGroup, C: np.ndarray) -> np.ndarray:
        """(columns of the layer, z): sums over the poses of its functions times C (P, c, z)."""
        C = layer.mix @ C
        P, c, z = C.shape
        f = layer.functions.shape[1]
        return (layer.functions.T @ C.reshape(P, -1)).reshape(f, c, z).transpose(1, 0, 2).reshape(c * f, z)

    def _whitened(self, layer: BlockGroup) -> np.ndarray:
        return self.screen.whiten(self._columns(layer, np.arange(layer.components), np.arange(layer.functions.shape[1])))

    def _columns(self, layer: BlockGroup, rows, index) -> np.ndarray:
        """(M, R, rows x index), component-major."""
        linear = self.screen.linear
        unit = np.stack([linear.unit(*key) for key in layer.keys], axis=2) @ layer.mix[np.asarray(rows)].T
        F = layer.functions[:, np.asarray(index)]
        F = F[linear.obs.pose] if layer.per_pose else F
        return (unit[:, :, :, None] * F[:, None, None, :]).reshape(*unit.shape[:2], -1)

    def judge(self, screen: CandidateScoring) -> JudgedMap:
        """screen: this atlas' screen, with effects and groups adopted."""
        found: dict[tuple[str, str], MapCell] = {}
        at_place: dict[str, list[float]] = {}
        for number, (layer, plan, (S, b, raw)) in enumerate(zip(self.layers, self.chart.plans, self.base, strict=True)):
            if screen.more.shape[1]:
                taken = self._more(layer, screen)
                S, b = less(S, plan, taken), b - taken @ screen.taken
            self._weigh(number, layer, S, b, raw, found, at_place)
        count = np.log(len(at_place))
        mean = {at: log_mean(np.array(logs)) for at, logs in at_place.items()}
        ranked = dict(sorted(mean.items(), key=lambda item: -item[1]))
        total = float(np.logaddexp.reduce(list(mean.values())) - count)
        return JudgedMap(sorted(found.values(), key=lambda c: -c.log_ratio), ranked, total)

    def _more(self, layer: BlockGroup, screen: CandidateScoring) -> np.ndarray:
        """(k, adopted) products of the layer's columns with what is adopted."""
        if not layer.per_pose:
            return self._whitened(layer).T @ screen.more
        return self._by_functions(layer, screen.reduced_more(layer.keys))

    def _weigh(self, number, layer, S, b, raw, found, at_place) -> None:
        for block, own in zip(self.chart.plans[number].blocks, S, strict=True):
            logs, gains, used = log_ratio(own, b[block.index], raw[block.index], block.weight)
            at = [layer.entries[e][0] for e in block.entries]
            for place in set(at):
                at_place.setdefault(place, []).extend(logs[[j for j, a in enumerate(at) if a == place]] if len(set(at)) > 1 else logs)
            best: dict[tuple[str, str], int] = {}
            for j, e in enumerate(block.entries):
                key = at[j], layer.entries[e][2].depends_on
                if key not in best or logs[j] > logs[best[key]]:
                    best[key] = j
            for (place, on), j in best.items():
                _, rows, shape = layer.entries[block.entries[j]]
                log = float(logs[j])
                keep(found, MapCell(place, on, log, log - self.shares[place], float(gains[j]), float(used[j]), number, rows, shape))

    def group(self, cell: MapCell) -> RandomEffect:
        """The cell's columns, each of unit size (or zero, where these data do not see it), as a group for the smooth model."""
        layer = self.layers[cell.layer]
        f = layer.functions.shape[1]
        columns = self._columns(layer, cell.rows, cell.shape.index)
        raw = self.base[cell.layer][2][(np.array(cell.rows)[:, None] * f + cell.shape.index).reshape(-1)]
        return RandomEffect(
            cell.at, cell.depends_on, columns / np.sqrt(np.maximum(raw, 1e-200)), np.tile(cell.shape.weight, len(cell.rows))
        )


def less(blocks: list[np.ndarray], plan: BlockPlan, taken: np.ndarray) -> list[np.ndarray]:
    """Blocks (H, k, k) less what a projection takes: taken (columns, z)."""
    out = []
    for S, block in zip(blocks, plan.blocks, strict=True):
        T = taken[block.index]
        out.append(S - T @ np.swapaxes(T, 1, 2))
    return out


def keep(found: dict[tuple[str, str], MapCell], cell: MapCell) -> None:
    key = cell.at, cell.depends_on
    if key not in found or cell.log_ratio > found[key].log_ratio:
        found[key] = cell
