"""Design blocks of unmodelled effects: locations by shapes, laid out so that many are scored in one product."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.nonparametric import basis_functions
from mbcacq.diagnosis.nonparametric.basis_functions import Basis, Location, Shape, components
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, StandstillRows
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.functions import DescribedPart, Product, linear, of, times


@dataclass(frozen=True)
class DesignBlock:
    """Some components (rows of the mix) of a location by one shape. at: name of the location."""

    location: Location
    rows: tuple[int, ...]
    shape: Shape
    at: str


@dataclass(frozen=True)
class Batch:
    """Blocks of v choices of r components, rows (v, r), by n shapes of k functions: their columns and prior weights (v n, r k)."""

    blocks: list[DesignBlock]
    rows: np.ndarray
    columns: np.ndarray
    weight: np.ndarray

    def of(self, products: np.ndarray) -> np.ndarray:
        """(v n, r k, r k) of the products (n, c, c, k, k) of all components."""
        chosen = products[:, self.rows[:, :, None], self.rows[:, None, :]]
        return chosen.transpose(1, 0, 2, 4, 3, 5).reshape(*self.columns.shape, -1)


@dataclass(frozen=True)
class BlockGroup:
    """A location by some shapes, in every choice of its components; blocks of more than ``most`` coefficients are left out.

    A column's flat index is row * number of functions + function.
    """

    location: Location
    shapes: list[Shape]
    most: float = np.inf

    @cached_property
    def functions(self) -> np.ndarray:
        """(P or M, f) of all shapes."""
        return np.concatenate([shape.values for shape in self.shapes], axis=1)

    @cached_property
    def batches(self) -> list[tuple[np.ndarray, list[Batch]]]:
        """For each number of functions k: which of the group's shapes have so many (n, k), and the batches of their blocks."""
        sizes = np.array([len(shape.weight) for shape in self.shapes])
        out = []
        for k in np.unique(sizes):
            own = np.flatnonzero(sizes == k)
            functions = np.cumsum(sizes)[own][:, None] - k + np.arange(k)
            possible = [rows for rows in self.location.variants if len(rows) * k <= self.most]
            alike = [[rows for rows in possible if len(rows) == r] for r in sorted(set(map(len, possible)))]
            out.append((functions, [self._batch(rows, [self.shapes[j] for j in own], functions) for rows in alike]))
        return out

    def _batch(self, variants: list[tuple[int, ...]], shapes: list[Shape], functions: np.ndarray) -> Batch:
        rows = np.array(variants)
        columns = rows[:, None, :, None] * self.functions.shape[1] + functions[None, :, None, :]
        weight = np.broadcast_to(np.array([shape.weight for shape in shapes])[None, :, None, :], columns.shape)
        blocks = [DesignBlock(self.location, one, shape, shape.at or self.location.name) for one in variants for shape in shapes]
        flat = len(blocks), -1
        return Batch(blocks, rows, columns.reshape(flat), weight.reshape(flat))

    @cached_property
    def blocks(self) -> list[DesignBlock]:
        """In the order of the batches."""
        return [block for _, batches in self.batches for batch in batches for block in batch.blocks]


@dataclass(frozen=True)
class DesignBlocks:
    """All design blocks of one recording, made when they are first asked for, in another process anew."""

    context: Context

    def __reduce__(self) -> tuple:
        return DesignBlocks, (self.context,)

    @cached_property
    def groups(self) -> list[BlockGroup]:
        s = self.context
        by_pose, by_centre = Basis.of(s), Basis.of(s, per_pose=False)
        common = basis_functions.of_poses(by_pose)
        angles = [shape for i in basis_functions.turning(s) for shape in by_pose.thresholds(s.position(i))]
        angles += basis_functions.pairs(by_pose, basis_functions.turning(s), 2)
        out = [BlockGroup(at, [*common, *basis_functions.at_location(by_pose, at, angles)]) for at in basis_functions.locations_of_arm(s)]
        return out + of_stations(by_pose) + of_scanner(by_centre)

    @cached_property
    def blocks(self) -> list[DesignBlock]:
        """The blocks of all groups, in their order."""
        return [block for group in self.groups for block in group.blocks]

    @property
    def locations(self) -> set[str]:
        return {block.at for block in self.blocks}

    def candidate(self, number: int) -> Candidate:
        """One of the blocks as an effect of a set, the same at every call."""

        def made() -> Candidate:
            block = self.blocks[number]
            parts = block.location.described(block.rows, block.shape.columns)
            weight = np.tile(block.shape.weight, len(block.rows))
            return unmodelled_candidate(block.at, block.shape.depends_on, parts, weight, f"block {number}")

        return self.context.computed_once(("block", number), made)


def unmodelled_candidate(at: str, depends_on: str, parts: Sequence[DescribedPart], weight: np.ndarray, variant: str) -> Candidate:
    """An unmodelled effect, which has no parameters to report. weight: (k,) relative prior sigma of its coefficients."""
    return Candidate(UNKNOWN, (at,), depends_on, StandstillRows(parts, weight), lambda c, v, h: {}, several=True, variant=variant)


def of_stations(basis: Basis) -> list[BlockGroup]:
    """Each station moving while it is measured, where enough was measured to see it; they share their components."""
    s = basis.here
    name, found = basis_functions.clock(s), list[Shape]()
    measured, poses = np.unique(s.obs.station, return_counts=True)
    for k in measured[poses > 6] if len(measured) > 1 else ():
        here, at = of("station", "is", k), f"station{s.obs.cell.stations[k].id}"
        middle = float(basis.values(name)[s.obs.station == k].mean())
        away = of(name, "distance", middle)
        columns = times(here, (*linear(name), Product(-middle))), times(here, away, away)
        found += basis.shapes(name, columns[:1], at=at) + basis.shapes(name, columns, falling=True, at=at)
    location = Location("station", components("station"), np.eye(6), ((0, 1, 2), tuple(range(6))))
    return [BlockGroup(location, found)] if found else []


def of_scanner(basis: Basis) -> list[BlockGroup]:
    """Errors of the measured point by where it is, and when; and each ball of an artefact of several."""
    obs, owner = basis.here.obs, basis.here.obs.cell.ball_artefact
    out = [BlockGroup(basis_functions.scanner_location(), basis_functions.of_centres(basis))] if np.ptp(obs.xyz, axis=0).max() > 0 else []
    station, shifted = obs.station[obs.pose], list[Shape]()
    for k, ball in enumerate(obs.cell.ball_ids):
        here = obs.ball == k
        if here.sum() < 3 or np.sum(owner == owner[k]) < 3:
            continue
        own, at = of("ball", "is", ball), f"ball{ball}"
        shift = basis.shapes("x", [own], at=at)  # none where no other ball was measured: it is that of all points
        at_each_station = [times(own, of("station", "is", j)) for j in np.unique(station[here])]
        shifted += shift + (basis.shapes("station", at_each_station, at=at) if shift and len(at_each_station) > 1 else [])
    balls = Location("ball", components("ball", count=3), np.eye(3), ((0, 1, 2),))  # they share their components
    return [*out, BlockGroup(balls, shifted)] if shifted else out
