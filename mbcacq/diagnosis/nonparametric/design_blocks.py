"""What there is to weigh where nothing has a name: places by shapes, laid out so that many are weighed at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric import basis_functions, locations, periodic_component
from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction, BasisTable
from mbcacq.effects.context import Context


@dataclass(frozen=True)
class BlockGroup:
    """Places that share columns: one of the arm by functions of the pose, or several by functions of the centre.

    entries: (at, rows of mix, shape). A column's flat index is row * number of functions + function.
    """

    components: int
    functions: np.ndarray
    entries: list[tuple[str, tuple[int, ...], BasisFunction]]
    keys: tuple[tuple[str, int, int], ...]
    mix: np.ndarray
    per_pose: bool


@dataclass(frozen=True)
class DesignBlock:
    """Groups of a layer with the same number k of coefficients: which entries, their flat columns (H, k) and weights (H, k); where the
    products of two of their columns lie (H, k, k): which pair of components, which pair of functions.
    """

    entries: list[int]
    index: np.ndarray
    weight: np.ndarray
    components: np.ndarray
    functions: np.ndarray


@dataclass(frozen=True)
class BlockPlan:
    """Of a layer: its blocks, and, of functions of the pose, the products (P, pairs) of every two that are together in a shape."""

    blocks: list[DesignBlock]
    products: np.ndarray


class DesignBlocks:
    """What there is to weigh in one situation: layers, their groups by size, and prior shares. Made once."""

    def __init__(self, s: Context):
        self.layers = layers(s)
        self.shares = shares(self.layers)
        self.plans = [planned(layer) for layer in self.layers]


def planned(layer: BlockGroup) -> BlockPlan:
    f, c = layer.functions.shape[1], layer.components
    by_size: dict[int, list[int]] = {}
    for e, (_, rows, shape) in enumerate(layer.entries):
        by_size.setdefault(len(rows) * len(shape.index), []).append(e)
    number = np.full((f, f), -1)
    for _, _, shape in layer.entries:
        number[np.ix_(shape.index, shape.index)] = 0
    together = np.argwhere(np.triu(number == 0))
    number[together[:, 0], together[:, 1]] = number[together[:, 1], together[:, 0]] = np.arange(len(together))
    out = []
    for entries in by_size.values():
        row = np.array([np.repeat(layer.entries[e][1], len(layer.entries[e][2].index)) for e in entries])
        column = np.array([np.tile(layer.entries[e][2].index, len(layer.entries[e][1])) for e in entries])
        weight = np.array([np.tile(layer.entries[e][2].weight, len(layer.entries[e][1])) for e in entries])
        functions = number[column[:, :, None], column[:, None]]
        out.append(DesignBlock(entries, row * f + column, weight, row[:, :, None] * c + row[:, None], functions))
    first, second = together.T if layer.per_pose else together[:0].T
    return BlockPlan(out, layer.functions[:, first] * layer.functions[:, second])


def shares(layers: list[BlockGroup]) -> dict[str, float]:
    """Place -> log of one over the prior share of one of its groups."""
    count: dict[str, int] = {}
    for layer in layers:
        for at, _, _ in layer.entries:
            count[at] = count.get(at, 0) + 1
    return {at: float(np.log(n * len(count))) for at, n in count.items()}


def layers(s: Context) -> list[BlockGroup]:
    common = basis_functions.of_poses(s)
    out = []
    for place in locations.of_arm(s):
        table = BasisTable(list(common.columns), list(common.shapes))
        for frame in {place.frame, max(place.frame - (len(place.mix) > 1), 0)}:
            append(table, basis_functions.moments(s, frame))
        own, name = s.obs.q[:, place.joint], f"q{place.joint + 1}"
        if np.ptp(own) > 0.02:
            append(table, basis_functions.turns(own, name))
            if len(place.mix) == 1:
                append(table, basis_functions.fine(own, name))
        for i in range(s.n if len(place.mix) == 1 else 0):
            if np.ptp(s.obs.q[:, i]) > 0.02:
                append(table, basis_functions.bends(s.obs.q[:, i], f"q{i + 1}"))
        if len(place.mix) == 1 and np.ptp(s.gravity_torque[:, place.joint]) > 0.02 * np.ptp(s.gravity_torque, axis=0).max() + 1e-9:
            append(table, basis_functions.bends(s.gravity_torque[:, place.joint], f"gravity_torque_{place.joint + 1}"))
        entries = [(place.at, rows, shape) for rows in place.variants for shape in table.shapes]
        out.append(BlockGroup(len(place.mix), table.values, entries, place.keys, place.mix, True))
    out += of_stations(s)
    out += of_scanner(s) if s.scanner_on_flange else of_instrument(s)
    return out


def append(table: BasisTable, more: BasisTable) -> None:
    start = len(table.columns)
    table.columns += more.columns
    table.shapes += [BasisFunction(shape.depends_on, shape.index + start, shape.weight) for shape in more.shapes]


def of_stations(s: Context) -> list[BlockGroup]:
    """Each station moving while it is measured: evenly, and bent."""
    table, entries, name = BasisTable(), [], "time" if s.obs.time_s is not None else "pose"
    mine = locations.stations(s)
    for k, place in mine:
        here = s.obs.station == k
        clock = np.asarray(s.time if s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0 else s.order, dtype=float)
        x = np.where(here, (clock - clock[here].mean()) / max(float(clock[here].std()), 1e-12), 0.0)
        index = table.add(np.stack([x, np.where(here, x * x, 0.0)], axis=1))
        chosen = [BasisFunction(name, index[:1], np.ones(1)), BasisFunction(name, index, np.array([1.0, 0.5]))]
        entries += [(place.at, rows, shape) for rows in place.variants for shape in chosen if len(shape.index)]
    if not entries:
        return []
    return [BlockGroup(6, table.values, entries, mine[0][1].keys, np.eye(6), True)]


def of_instrument(s: Context) -> list[BlockGroup]:
    """What an instrument that stands beside the arm measures wrongly, by the place of the target in its own frame."""
    if np.ptp(s.obs.xyz, axis=0).min() == 0:
        return []
    table = basis_functions.of_volume(s)
    entries = [("scanner", rows, shape) for shape in table.shapes for rows in ((0,), (1,), (2,), (0, 1, 2))]
    return [BlockGroup(3, table.values, entries, tuple(("point", 0, c) for c in range(3)), np.eye(3), False)]


def of_scanner(s: Context) -> list[BlockGroup]:
    """The measured point by place in the field of view, tilt, time; and each ball of an artefact of several."""
    out, obs, owner = [], s.obs, s.obs.cell.ball_artefact
    if np.ptp(obs.xyz, axis=0).max() > 0:
        table = basis_functions.of_field(s)
        waves = [(name, periodic_component.waves(obs.xyz[:, c])) for c, name in enumerate("xy") if np.ptp(obs.xyz[:, c]) > 0]
        for name, values in waves:
            index = table.add(values)
            table.shape(name, index)
            for j in range(0, len(index) - 1, 2):
                table.shape(name, index[j : j + 2])
        variants = ((0,), (1,), (2,), (0, 1), (0, 1, 2))
        entries = [("scanner", rows, shape) for shape in table.shapes for rows in variants if len(rows) * len(shape.index) < 60]
        out.append(BlockGroup(3, table.values, entries, tuple(("point", 0, c) for c in range(3)), np.eye(3), False))
    table, entries = BasisTable(), []
    for k, ball in enumerate(obs.cell.ball_ids):
        seen = obs.ball == k
        if seen.sum() >= 3 and np.sum(owner == owner[k]) >= 3:
            index = table.add(seen)
            entries.append((f"ball{ball}", (0, 1, 2), BasisFunction("x", index, np.ones(len(index)))))
    if entries:
        out.append(BlockGroup(3, table.values, entries, tuple(("ball", 0, c) for c in range(3)), np.eye(3), False))
    return out
