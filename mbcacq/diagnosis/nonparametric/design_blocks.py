"""Design blocks of unmodelled effects: locations by shapes, laid out so that many are scored in one product."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.nonparametric import basis_functions, locations, periodic_component
from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction, BasisTable
from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.effects.context import Context

POINT = tuple(("point", 0, c) for c in range(3))


@dataclass(frozen=True)
class BlockGroup:
    """Locations that share columns: one of the arm by functions of the pose, or several by functions of the centre.

    entries: (location, rows of mix, shape), one for each design block. A column's flat index is row * number of functions + function.
    """

    components: int
    functions: np.ndarray
    entries: list[tuple[str, tuple[int, ...], BasisFunction]]
    keys: tuple[tuple[str, int, int], ...]
    mix: np.ndarray
    per_pose: bool


@dataclass(frozen=True)
class DesignBlock:
    """Entries of a group with the same number k of coefficients: which entries, their flat columns (H, k) and weights (H, k); where the
    products of two of their columns are (H, k, k): which pair of components, which pair of functions.
    """

    entries: list[int]
    index: np.ndarray
    weight: np.ndarray
    components: np.ndarray
    functions: np.ndarray


@dataclass(frozen=True)
class BlockPlan:
    """Of a group: its blocks, and, of functions of the pose, the products (P, pairs) of every two that are together in a shape."""

    blocks: list[DesignBlock]
    products: np.ndarray


@dataclass(frozen=True)
class DesignBlocks:
    """All design blocks of one recording, each part made when it is first asked for."""

    context: Context

    @cached_property
    def groups(self) -> list[BlockGroup]:
        return block_groups(self.context)

    @cached_property
    def log_prior_shares(self) -> dict[str, float]:
        return log_prior_shares(self.groups)

    @cached_property
    def plans(self) -> list[BlockPlan]:
        return [planned(group) for group in self.groups]


@dataclass(frozen=True)
class GivenBlocks:
    """Blocks that somebody else laid out, with the same fields as ``DesignBlocks``."""

    groups: list[BlockGroup]
    plans: list[BlockPlan]
    log_prior_shares: dict[str, float]


def planned(group: BlockGroup) -> BlockPlan:
    """The entries of a group by their number of coefficients."""
    f, c = group.functions.shape[1], group.components
    by_size: dict[int, list[int]] = {}
    for e, (_, rows, shape) in enumerate(group.entries):
        by_size.setdefault(len(rows) * len(shape.index), []).append(e)
    number = np.full((f, f), -1)
    for _, _, shape in group.entries:
        number[np.ix_(shape.index, shape.index)] = 0
    together = np.argwhere(np.triu(number == 0))
    number[together[:, 0], together[:, 1]] = number[together[:, 1], together[:, 0]] = np.arange(len(together))
    out = []
    for entries in by_size.values():
        row = np.array([np.repeat(group.entries[e][1], len(group.entries[e][2].index)) for e in entries])
        column = np.array([np.tile(group.entries[e][2].index, len(group.entries[e][1])) for e in entries])
        weight = np.array([np.tile(group.entries[e][2].weight, len(group.entries[e][1])) for e in entries])
        functions = number[column[:, :, None], column[:, None]]
        out.append(DesignBlock(entries, row * f + column, weight, row[:, :, None] * c + row[:, None], functions))
    first, second = together.T if group.per_pose else together[:0].T
    return BlockPlan(out, group.functions[:, first] * group.functions[:, second])


def log_prior_shares(groups: list[BlockGroup]) -> dict[str, float]:
    """Location -> log of one over the prior share of one of its blocks."""
    count: dict[str, int] = {}
    for group in groups:
        for location, _, _ in group.entries:
            count[location] = count.get(location, 0) + 1
    return {location: float(np.log(n * len(count))) for location, n in count.items()}


def block_groups(s: Context) -> list[BlockGroup]:
    common = basis_functions.of_poses(s)
    out = [of_arm_location(s, location, common) for location in locations.of_arm(s)]
    out += of_stations(s)
    out += of_scanner(s) if s.scanner_on_flange else of_instrument(s)
    return out


def of_arm_location(s: Context, location: Location, common: BasisTable) -> BlockGroup:
    """A joint, a link, the base or the mount, moving with the pose."""
    table, is_joint = BasisTable(list(common.columns), list(common.shapes)), len(location.mix) == 1
    for frame in {location.frame, max(location.frame - (not is_joint), 0)}:
        append(table, basis_functions.gravity_moments(s, frame))
    own, name = s.obs.q[:, location.joint], f"q{location.joint + 1}"
    if np.ptp(own) > 0.02:
        append(table, basis_functions.higher_harmonics(own, name))
        if is_joint:
            append(table, basis_functions.narrow(own, name))
    if is_joint:
        append_thresholds(s, table, location.joint)
    entries = [(location.name, rows, shape) for rows in location.variants for shape in table.shapes]
    return BlockGroup(len(location.mix), table.values, entries, location.keys, location.mix, True)


def append_thresholds(s: Context, table: BasisTable, joint: int) -> None:
    """What sets in, at a joint, at some angle of any joint or at some torque of its own."""
    for i in range(s.n):
        if np.ptp(s.obs.q[:, i]) > 0.02:
            append(table, basis_functions.thresholds(s.obs.q[:, i], f"q{i + 1}"))
    torque = s.gravity_torque
    if np.ptp(torque[:, joint]) > 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
        append(table, basis_functions.thresholds(torque[:, joint], f"gravity_torque_{joint + 1}"))


def append(table: BasisTable, more: BasisTable) -> None:
    """Add the columns and shapes of another table."""
    start = len(table.columns)
    table.columns += more.columns
    table.shapes += [BasisFunction(shape.depends_on, shape.index + start, shape.weight) for shape in more.shapes]


def of_stations(s: Context) -> list[BlockGroup]:
    """Each station moving while it is measured: linearly and quadratically."""
    table, entries, name = BasisTable(), list[tuple[str, tuple[int, ...], BasisFunction]](), "time" if s.obs.time_s is not None else "pose"
    stations = locations.stations(s)
    for k, location in stations:
        here = s.obs.station == k
        clock = np.asarray(s.time if s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0 else s.order, dtype=float)
        x = np.where(here, (clock - clock[here].mean()) / max(float(clock[here].std()), 1e-12), 0.0)
        index = table.add(np.stack([x, np.where(here, x * x, 0.0)], axis=1))
        chosen = [BasisFunction(name, index[:1], np.ones(1)), BasisFunction(name, index, np.array([1.0, 0.5]))]
        entries += [(location.name, rows, shape) for rows in location.variants for shape in chosen if len(shape.index)]
    if not entries:
        return []
    return [BlockGroup(6, table.values, entries, stations[0][1].keys, np.eye(6), True)]


def of_instrument(s: Context) -> list[BlockGroup]:
    """Errors of an instrument that stands next to the arm, by the position of the target in its own frame."""
    if np.ptp(s.obs.xyz, axis=0).min() == 0:
        return []
    table = basis_functions.of_volume(s)
    entries = [("scanner", rows, shape) for shape in table.shapes for rows in ((0,), (1,), (2,), (0, 1, 2))]
    return [BlockGroup(3, table.values, entries, POINT, np.eye(3), False)]


def of_scanner(s: Context) -> list[BlockGroup]:
    """Errors of the measured point by its position in the field of view, tilt, time; and each ball of an artefact of several."""
    obs, owner, out = s.obs, s.obs.cell.ball_artefact, list[BlockGroup]()
    if np.ptp(obs.xyz, axis=0).max() > 0:
        table = basis_functions.of_field(s)
        periodic = [(name, periodic_component.harmonics(obs.xyz[:, c])) for c, name in enumerate("xy") if np.ptp(obs.xyz[:, c]) > 0]
        for name, values in periodic:
            index = table.add(values)
            table.shape(name, index)
            for j in range(0, len(index) - 1, 2):
                table.shape(name, index[j : j + 2])
        variants = ((0,), (1,), (2,), (0, 1), (0, 1, 2))
        entries = [("scanner", rows, shape) for shape in table.shapes for rows in variants if len(rows) * len(shape.index) < 60]
        out.append(BlockGroup(3, table.values, entries, POINT, np.eye(3), False))
    table, entries = BasisTable(), []
    for k, ball in enumerate(obs.cell.ball_ids):
        measured = obs.ball == k
        if measured.sum() >= 3 and np.sum(owner == owner[k]) >= 3:
            index = table.add(measured)
            if not len(index):  # no other ball was measured: its shift is that of all points
                continue
            entries.append((f"ball{ball}", (0, 1, 2), BasisFunction("x", index, np.ones(len(index)))))
            loose = at_each_station(s, table, measured)
            if len(loose) > 1:
                entries.append((f"ball{ball}", (0, 1, 2), BasisFunction("station", loose, np.ones(len(loose)))))
    if entries:
        out.append(BlockGroup(3, table.values, entries, tuple(("ball", 0, c) for c in range(3)), np.eye(3), False))
    return out


def at_each_station(s: Context, table: BasisTable, measured: np.ndarray) -> np.ndarray:
    """Columns of a ball that lies elsewhere at every station; measured: (M,) bool of its centres."""
    station = s.obs.station[s.obs.pose]
    each = [measured & (station == k) for k in np.unique(station[measured])]
    return table.add(np.stack(each, axis=1)) if len(each) > 1 else np.zeros(0, int)
