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
class SizedBlocks:
    """All design blocks with k coefficients, group after group. index (H, k): their columns, among those of all groups; weight (H, k).

    products: of each group in turn, where in the table of the group's products those of every two
    columns of a block stand, two indices (h, k, k). The table is, for functions of the pose, pairs of components by pairs of functions; for
    functions of the centre, columns by columns.
    """

    index: np.ndarray
    weight: np.ndarray
    products: tuple[tuple[int, np.ndarray, np.ndarray], ...]


@dataclass(frozen=True)
class BlockLayout:
    """Where the design blocks of all groups stand, those of one size together; B blocks in all, in the order of ``sizes``.

    start: (G + 1,) first column of each group. pairs: of each group, the products (P, pairs) of every two functions that are together in a
    shape. connected: of each group, the functions that shapes connect, class by class. members: (group, entry) of each block. location
    (B,), cell (B,): indices into ``locations`` and ``cells``, each a location with a covariate.
    """

    sizes: tuple[SizedBlocks, ...]
    start: np.ndarray
    pairs: tuple[np.ndarray, ...]
    connected: tuple[list[np.ndarray], ...]
    locations: tuple[str, ...]
    cells: tuple[tuple[str, str], ...]
    members: tuple[tuple[int, int], ...]
    location: np.ndarray
    cell: np.ndarray


class _LaidOut:
    """What follows from groups of blocks."""

    groups: list[BlockGroup]

    @cached_property
    def log_prior_shares(self) -> dict[str, float]:
        return log_prior_shares(self.groups)

    @cached_property
    def layout(self) -> BlockLayout:
        return block_layout(self.groups)


@dataclass(frozen=True)
class DesignBlocks(_LaidOut):
    """All design blocks of one recording, each part made when it is first asked for."""

    context: Context

    @cached_property
    def groups(self) -> list[BlockGroup]:  # pyright: ignore[reportIncompatibleVariableOverride] -- read only, as all of it
        return block_groups(self.context)


@dataclass(frozen=True)
class GivenBlocks(_LaidOut):
    """Blocks that somebody else laid out, with the same fields as ``DesignBlocks``."""

    groups: list[BlockGroup]


def block_layout(groups: list[BlockGroup]) -> BlockLayout:
    """The entries of all groups by their number of coefficients."""
    start = np.cumsum([0] + [group.components * group.functions.shape[1] for group in groups])
    pairs, number = zip(*[pairs_of(group) for group in groups], strict=True)
    by_size: dict[int, list[tuple[int, int]]] = {}
    for g, group in enumerate(groups):
        for e, (_, rows, shape) in enumerate(group.entries):
            by_size.setdefault(len(rows) * len(shape.index), []).append((g, e))
    sizes = tuple(sized_blocks(groups, start, number, count, of_size) for count, of_size in by_size.items())
    members = tuple(member for of_size in by_size.values() for member in of_size)
    named = [groups[g].entries[e] for g, e in members]
    locations = tuple(dict.fromkeys(location for location, _, _ in named))
    cells = tuple(dict.fromkeys((location, shape.depends_on) for location, _, shape in named))
    location = np.array([locations.index(location) for location, _, _ in named], dtype=int)
    cell_number = {cell: j for j, cell in enumerate(cells)}
    cell = np.array([cell_number[location, shape.depends_on] for location, _, shape in named], dtype=int)
    connected = tuple(connected_functions(group) for group in groups)
    return BlockLayout(sizes, start, tuple(pairs), connected, locations, cells, members, location, cell)


def pairs_of(group: BlockGroup) -> tuple[np.ndarray, np.ndarray]:
    """Products (P, pairs) of every two functions that are together in a shape, and the number (f, f) of each pair.

    Functions of the centre have no such products: theirs are made of whole columns.
    """
    f = group.functions.shape[1]
    number = np.full((f, f), -1)
    for index in {shape.index.tobytes(): shape.index for _, _, shape in group.entries}.values():
        number[index[:, None], index] = 0
    first, second = np.nonzero(np.triu(number == 0))
    number[first, second] = number[second, first] = np.arange(len(first))
    if not group.per_pose:
        first, second = first[:0], second[:0]
    return group.functions[:, first] * group.functions[:, second], number


def connected_functions(group: BlockGroup) -> list[np.ndarray]:
    """The functions of a group, by classes of which no two share a shape."""
    label = np.arange(group.functions.shape[1])
    for index in {shape.index.tobytes(): shape.index for _, _, shape in group.entries}.values():
        least, *others = sorted(set(label[index].tolist()))
        for other in others:
            label[label == other] = least
    return [np.flatnonzero(label == one) for one in np.unique(label)]


def sized_blocks(
    groups: list[BlockGroup], start: np.ndarray, number: tuple[np.ndarray, ...], count: int, members: list[tuple[int, int]]
) -> SizedBlocks:
    """The blocks of ``count`` coefficients. number: of each group, of the pairs of its functions; members: (group, entry), by group."""
    index, weight, products = [], [], []
    group, entry = np.array(members).T
    for g in np.unique(group):
        of_group, chosen = groups[g], [groups[g].entries[e] for e in entry[group == g]]
        row, function = np.empty((2, len(chosen), count), dtype=int)
        prior = np.empty((len(chosen), count))
        for r in {len(rows) for _, rows, _ in chosen}:
            here = np.array([len(rows) == r for _, rows, _ in chosen])
            rows = np.array([rows for _, rows, _ in chosen if len(rows) == r])
            shapes = [shape for _, rows, shape in chosen if len(rows) == r]
            row[here] = np.repeat(rows, count // r, axis=1)
            function[here] = np.tile(np.array([shape.index for shape in shapes]), (1, r))
            prior[here] = np.tile(np.array([shape.weight for shape in shapes]), (1, r))
        column = row * of_group.functions.shape[1] + function
        index.append(start[g] + column)
        weight.append(prior)
        if of_group.per_pose:
            pair = row[:, :, None] * of_group.components + row[:, None]
            products.append((int(g), pair, number[g][function[:, :, None], function[:, None]]))
        else:
            products.append((int(g), *np.broadcast_arrays(column[:, :, None], column[:, None])))
    return SizedBlocks(np.concatenate(index), np.concatenate(weight), tuple(products))


def log_prior_shares(groups: list[BlockGroup]) -> dict[str, float]:
    """Location -> log of one over the prior share of one of its blocks."""
    count: dict[str, int] = {}
    for group in groups:
        for location, _, _ in group.entries:
            count[location] = count.get(location, 0) + 1
    return {location: float(np.log(n * len(count))) for location, n in count.items()}


def block_groups(s: Context) -> list[BlockGroup]:
    common, angles = basis_functions.of_poses(s), thresholds_of_angles(s)
    out = [of_arm_location(s, location, common, angles) for location in locations.of_arm(s)]
    out += of_stations(s)
    out += of_scanner(s) if s.scanner_on_flange else of_instrument(s)
    return out


def of_arm_location(s: Context, location: Location, common: BasisTable, angles: BasisTable) -> BlockGroup:
    """A joint, a link, the base or the mount, moving with the pose. common: functions for every location; angles: more for the joints."""
    table, is_joint = BasisTable(list(common.columns), list(common.shapes)), len(location.mix) == 1
    for frame in {location.frame, max(location.frame - (not is_joint), 0)}:
        append(table, basis_functions.gravity_moments(s, frame))
    own, name = s.obs.q[:, location.joint], f"q{location.joint + 1}"
    if np.ptp(own) > 0.02:
        append(table, basis_functions.higher_harmonics(own, name))
        if is_joint:
            append(table, basis_functions.narrow(own, name))
    if is_joint:
        append(table, angles)
        append_thresholds_of_torque(s, table, location.joint)
    entries = [(location.name, rows, shape) for rows in location.variants for shape in table.shapes]
    return BlockGroup(len(location.mix), table.values, entries, location.keys, location.mix, True)


def thresholds_of_angles(s: Context) -> BasisTable:
    """What sets in, at a joint, at some angle of any joint."""
    table = BasisTable()
    for i in range(s.n):
        if np.ptp(s.obs.q[:, i]) > 0.02:
            append(table, basis_functions.thresholds(s.obs.q[:, i], f"q{i + 1}"))
    return table


def append_thresholds_of_torque(s: Context, table: BasisTable, joint: int) -> None:
    """What sets in, at a joint, at some torque of its own."""
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
