"""Evidence map of unmodelled effects: every location by every shape, by its Bayes factor beyond geometry and whatever is conditioned on.

Every shape at every choice of a location's components is a block of a normal matrix, of which only these blocks are made; those of one
size, of all locations, stand in one array. Conditioning on an effect or a group is a correction of low rank.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, DesignBlock
from mbcacq.diagnosis.search.bayes_factor import log_bayes_factors, log_mean
from mbcacq.diagnosis.search.candidate_scoring import ROUNDING, CandidateScoring, UnitKey


@dataclass(frozen=True)
class MapEvidence:
    """Log Bayes factor (B,) of all B design blocks. at: location -> its blocks. locations: location -> log of its mean Bayes factor, best
    first.
    """

    blocks: list[DesignBlock]
    log_bayes_factor: np.ndarray
    at: dict[str, np.ndarray]
    locations: dict[str, float]

    def best_at(self, location: str) -> int:
        """Number of the best block of a location."""
        here = self.at[location]
        return int(here[self.log_bayes_factor[here].argmax()])

    def strengths(self) -> dict[tuple[str, str], float]:
        """(location, covariate) -> log10 of the Bayes factor of the best block, corrected for the number of locations and of blocks there
        but not below zero; largest first.
        """
        out: dict[tuple[str, str], float] = {}
        for block, log in zip(self.blocks, self.log_bayes_factor, strict=True):
            strength = float(log - np.log(len(self.at[block.at]) * len(self.at))) / float(np.log(10))
            out[block.at, block.shape.depends_on] = max(out.get((block.at, block.shape.depends_on), 0.0), strength)
        return dict(sorted(out.items(), key=lambda one: -one[1]))


class EvidenceMap:
    """Evidence of all groups in one recording under one noise model, prepared with geometry alone projected out.

    b and raw (K,) belong to all columns of all groups: products with the residual, squares; absorbed (K, z): their products with the basis
    of the geometry. sizes: of the blocks with as many coefficients k, which they are (H,), their columns and prior weights (H, k) and
    normal matrices (H, k, k).
    """

    def __init__(self, projected: CandidateScoring, groups: Sequence[BlockGroup]):
        self.projected, self.groups = projected, groups
        self.blocks = [block for group in groups for block in group.blocks]
        basis = np.c_[projected.Q, projected.beyond_geometry()]
        products = self._products(basis, lambda keys: _with_residual(projected, keys), projected.stations)
        self.b = np.concatenate([each[:, -1] for each in products])
        self.raw = np.empty(len(self.b))
        of_size: dict[int, list[tuple[np.ndarray, ...]]] = {}
        block, column = 0, 0
        for group, absorbed in zip(groups, products, strict=True):
            mine = slice(column, column + len(absorbed))
            squares, taken = np.empty((len(group.location.mix), group.functions.shape[1])), absorbed[:, :-1]
            for (functions, batches), whole in zip(group.batches, self._normal(group), strict=True):
                squares[:, functions] = np.einsum("nccaa->cna", whole)
                for batch in batches:
                    S = projected_out(batch.of(whole), taken[batch.columns])
                    number = block + np.arange(len(S))
                    of_size.setdefault(S.shape[1], []).append((number, column + batch.columns, batch.weight, S))
                    block += len(S)
            self.raw[mine] = without_rounding(squares.reshape(-1))
            column = mine.stop
        self.sizes = [tuple(np.concatenate(one) for one in zip(*parts, strict=True)) for parts in of_size.values()]
        at: dict[str, list[int]] = {}
        for number, one in enumerate(self.blocks):
            at.setdefault(one.at, []).append(number)
        self.at = {location: np.array(here) for location, here in at.items()}

    def evaluate(self, projected: CandidateScoring) -> MapEvidence:
        """projected: this map's problem, possibly conditioned on effects and groups."""
        log, b, absorbed = np.empty(len(self.blocks)), self.b, None
        if projected.conditioned.shape[1]:
            absorbed = np.concatenate(self._products(projected.conditioned, projected.conditioned_pose_products))
            b = b - absorbed @ projected.along
        for number, columns, weight, S in self.sizes:
            beyond = S if absorbed is None else projected_out(S, absorbed[columns])
            typical = weight / np.sqrt(self.raw[columns])
            log[number] = log_bayes_factors(beyond * (typical[:, :, None] * typical[:, None, :]), b[columns] * typical)
        means = {location: float(log_mean(log[here])) for location, here in self.at.items()}
        ranked = dict(sorted(means.items(), key=lambda one: -one[1]))
        return MapEvidence(self.blocks, log, self.at, ranked)

    def _products(
        self, basis: np.ndarray, of_poses: Callable[[tuple[UnitKey, ...]], np.ndarray], stations: Sequence[np.ndarray] = ()
    ) -> list[np.ndarray]:
        """The products (columns, z) of each group's columns with a basis (rows, z).

        of_poses: its sums (P, c, z) over each pose with unit columns. stations: the poses of each, where the first columns of the basis,
        six of each station, vanish at the poses of all others.
        """
        out = []
        by_centre = None if all(group.location.per_pose for group in self.groups) else self.projected.whiten.transpose(basis)
        for group in self.groups:
            keys = group.location.keys
            if group.location.per_pose:
                out.append(by_functions(group, of_poses(keys), stations))
            else:
                out.append(by_functions(group, np.swapaxes(self._unit(keys), 1, 2) @ by_centre))
        return out

    def _unit(self, keys: tuple[UnitKey, ...]) -> np.ndarray:
        """(M, R, c) change of the prediction by each unit column of a location."""
        linear = self.projected.linear
        return linear.computed_once(keys, lambda: np.stack([linear.unit(*key) for key in keys], axis=2))

    def _normal(self, group: BlockGroup) -> list[np.ndarray]:
        """(n, c, c, k, k) for each batch of a group: products of its columns, before any projection, of every two components by every two
        of the functions of a shape.
        """
        mix, together = group.location.mix, [functions for functions, _ in group.batches]
        if not group.location.per_pose:
            return self.projected.whiten.gram(self._unit(group.location.keys) @ mix.T, group.functions, together)
        A = mix @ self.projected.pose_products(group.location.keys)[1] @ mix.T
        A, by_function, out = A.reshape(len(A), -1), np.ascontiguousarray(group.functions.T), []
        for index in together:
            F, (n, k) = by_function[index], index.shape
            products = (F[:, :, None] * F[:, None]).reshape(n * k * k, -1) @ A
            out.append(products.reshape(n, k, k, len(mix), len(mix)).transpose(0, 3, 4, 1, 2))
        return out


def _with_residual(projected: CandidateScoring, keys: tuple[UnitKey, ...]) -> np.ndarray:
    """(P, c, z + 1) sums over each pose of unit columns with the basis of the geometry, and with the residual."""
    b, _, C = projected.pose_products(keys)
    return np.concatenate([C, b[:, :, None]], axis=2)


def without_rounding(raw: np.ndarray) -> np.ndarray:
    """(k,) squares of a group's columns, with the largest in the place of those that are rounding. A turn of a bar about itself moves no
    ball, and its coefficient, in units of its motion, could be anything.
    """
    largest = float(raw.max(initial=1e-300))
    return np.where(raw > ROUNDING * largest, raw, largest)


def projected_out(S: np.ndarray, absorbed: np.ndarray) -> np.ndarray:
    """Blocks (H, k, k) less what a projection absorbs of their columns (H, k, z)."""
    return S - absorbed @ np.swapaxes(absorbed, 1, 2)


def by_functions(group: BlockGroup, C: np.ndarray, stations: Sequence[np.ndarray] = ()) -> np.ndarray:
    """(columns of the group, z): sums over the poses, or centres, of its functions times C (P or M, keys, z), of its components.

    stations: the poses of each, where the first columns of C, six of each station, vanish at the poses of all others.
    """
    c, z = C.shape[1:]
    functions, f, first = group.functions, group.functions.shape[1], 6 * len(stations)
    out = np.empty((c, f, z))
    out[:, :, first:] = np.tensordot(functions, C[:, :, first:], axes=(0, 0)).transpose(1, 0, 2)
    for j, poses in enumerate(stations):
        own = slice(6 * j, 6 * j + 6)
        out[:, :, own] = np.tensordot(functions[poses], C[poses, :, own], axes=(0, 0)).transpose(1, 0, 2)
    return np.tensordot(group.location.mix, out, axes=(1, 0)).reshape(-1, z)
