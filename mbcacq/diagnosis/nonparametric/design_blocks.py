"""Design blocks of unmodelled effects: locations by shapes, laid out so that many are scored in one product."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.nonparametric import basis_functions, locations
from mbcacq.diagnosis.nonparametric.basis_functions import Shape, shapes
from mbcacq.diagnosis.nonparametric.locations import SCANNER, Location
from mbcacq.effects.context import Context


@dataclass(frozen=True)
class DesignBlock:
    """Some components (rows of the mix) of a location by one shape. at: name of the location."""

    location: Location
    rows: tuple[int, ...]
    shape: Shape

    @property
    def at(self) -> str:
        return self.shape.at or self.location.name


@dataclass(frozen=True)
class Variants:
    """Blocks of v choices of r components, rows (v, r), by n shapes of k functions: their columns and prior weights (v n, r k)."""

    rows: np.ndarray
    columns: np.ndarray
    weight: np.ndarray

    def of(self, products: np.ndarray) -> np.ndarray:
        """(v n, r k, r k) of the products (n, c, c, k, k) of all components."""
        chosen = products[:, self.rows[:, :, None], self.rows[:, None, :]]
        return chosen.transpose(1, 0, 2, 4, 3, 5).reshape(*self.columns.shape, -1)


@dataclass(frozen=True)
class Batch:
    """The blocks of a group whose shapes have k functions: which of the group's these are (n, k)."""

    functions: np.ndarray
    variants: list[Variants]


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
    def batches(self) -> list[Batch]:
        ends, f = np.cumsum([len(shape.weight) for shape in self.shapes]), self.functions.shape[1]
        out = []
        for k, own in self._by_functions.items():
            functions = ends[own][:, None] - k + np.arange(k)
            weight, variants = np.array([self.shapes[j].weight for j in own]), []
            for rows in self._by_components(k):
                columns = rows[:, None, :, None] * f + functions[None, :, None, :]
                weights = np.broadcast_to(weight[None, :, None, :], columns.shape)
                flat = len(rows) * len(own), -1
                variants.append(Variants(rows, columns.reshape(flat), weights.reshape(flat)))
            out.append(Batch(functions, variants))
        return out

    @cached_property
    def blocks(self) -> list[DesignBlock]:
        """In the order of the batches."""
        return [
            DesignBlock(self.location, tuple(one), self.shapes[j])
            for k, own in self._by_functions.items()
            for rows in self._by_components(k)
            for one in rows.tolist()
            for j in own
        ]

    @cached_property
    def at(self) -> dict[str, np.ndarray]:
        """Name of a location -> which of the blocks are there."""
        names = [block.at for block in self.blocks]
        return {name: np.flatnonzero([name == one for one in names]) for name in dict.fromkeys(names)}

    @cached_property
    def _by_functions(self) -> dict[int, list[int]]:
        """Number of functions -> the shapes of so many."""
        sizes = [len(shape.weight) for shape in self.shapes]
        return {k: [j for j, size in enumerate(sizes) if size == k] for k in sorted(set(sizes))}

    def _by_components(self, k: int) -> list[np.ndarray]:
        """Choices of components (v, r) for shapes of k functions, those of as many components together."""
        sizes = sorted({len(rows) for rows in self.location.variants if len(rows) * k <= self.most})
        return [np.array([rows for rows in self.location.variants if len(rows) == r]) for r in sizes]


@dataclass(frozen=True)
class DesignBlocks:
    """All design blocks of one recording, made when they are first asked for."""

    context: Context

    @cached_property
    def groups(self) -> list[BlockGroup]:
        s = self.context
        common, angles = basis_functions.of_poses(s), basis_functions.thresholds_of_angles(s)
        out = [BlockGroup(at, [*common, *basis_functions.at_location(s, at, angles)]) for at in locations.of_arm(s)]
        out += of_stations(s)
        return out + (of_scanner(s) if s.scanner_on_flange else of_instrument(s))

    @property
    def locations(self) -> set[str]:
        return {name for group in self.groups for name in group.at}


def of_stations(s: Context) -> list[BlockGroup]:
    """Each station moving while it is measured: linearly and quadratically."""
    (name, clock), found = basis_functions.clock(s), list[Shape]()
    for k, station in locations.stations(s):
        here = s.obs.station == k
        x = np.where(here, (clock - clock[here].mean()) / max(float(clock[here].std()), 1e-12), 0.0)
        found += shapes(name, x, at=station) + shapes(name, np.stack([x, np.where(here, x * x, 0.0)], axis=1), falling=True, at=station)
    return [BlockGroup(locations.STATION, found)] if found else []


def of_instrument(s: Context) -> list[BlockGroup]:
    """Errors of an instrument that stands next to the arm, by the position of the target in its own frame."""
    if np.ptp(s.obs.xyz, axis=0).min() == 0:
        return []
    return [BlockGroup(replace(SCANNER, variants=((0,), (1,), (2,), (0, 1, 2))), basis_functions.of_volume(s))]


def of_scanner(s: Context) -> list[BlockGroup]:
    """Errors of the measured point by its position in the field of view, tilt, time; and each ball of an artefact of several."""
    obs, owner = s.obs, s.obs.cell.ball_artefact
    out = [BlockGroup(SCANNER, basis_functions.of_field(s), 59)] if np.ptp(obs.xyz, axis=0).max() > 0 else []
    station, shifted = obs.station[obs.pose], list[Shape]()
    for k, ball in enumerate(obs.cell.ball_ids):
        here = obs.ball == k
        if here.sum() < 3 or np.sum(owner == owner[k]) < 3:
            continue
        shift = shapes("x", here, at=f"ball{ball}")  # none where no other ball was measured: it is that of all points
        at_each_station = np.stack([here & (station == j) for j in np.unique(station[here])], axis=1)
        shifted += shift + (shapes("station", at_each_station, at=f"ball{ball}") if shift and at_each_station.shape[1] > 1 else [])
    return [*out, BlockGroup(locations.BALL, shifted)] if shifted else out
