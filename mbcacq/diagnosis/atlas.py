"""The map of what has no name: every place by every shape, weighed by its evidence beyond geometry and whatever is adopted.

For each place the normal matrix of all components times all functions is made once; every shape at every choice of components is a
block of it. Adopting an effect or a group is a correction of low rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis import places, ripple, shapes
from mbcacq.diagnosis.evidence import log_mean, log_ratio
from mbcacq.diagnosis.screen import Screen
from mbcacq.diagnosis.shapes import Shape, Table
from mbcacq.diagnosis.smooth import Group
from mbcacq.physics.situation import Situation


@dataclass(frozen=True)
class Cell:
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
    shape: Shape


@dataclass(frozen=True)
class Judged:
    """cells: best first, one for each (at, depends_on). places: place -> log of its mean evidence, best first. total: log, over all."""

    cells: list[Cell]
    places: dict[str, float]
    total: float

    def best(self) -> Cell:
        """The best cell of the best place."""
        return self.best_at(next(iter(self.places)))

    def best_at(self, at: str) -> Cell:
        return next(c for c in self.cells if c.at == at)


@dataclass(frozen=True)
class Layer:
    """Places that share columns: one of the arm by functions of the pose, or several by functions of the centre.

    entries: (at, rows of mix, shape). A column's flat index is row * number of functions + function.
    """

    components: int
    functions: np.ndarray
    entries: list[tuple[str, tuple[int, ...], Shape]]
    keys: tuple[tuple[str, int, int], ...]
    mix: np.ndarray
    per_pose: bool


@dataclass(frozen=True)
class Block:
    """Groups of a layer with the same number of coefficients: which entries, their flat columns (H, k) and weights (H, k)."""

    entries: list[int]
    index: np.ndarray
    weight: np.ndarray


class Chart:
    """What there is to weigh in one situation: layers, their groups by size, and prior shares. Made once."""

    def __init__(self, s: Situation):
        self.layers = layers(s)
        self.shares = shares(self.layers)
        self.blocks = [blocks(layer) for layer in self.layers]


def blocks(layer: Layer) -> list[Block]:
    f = layer.functions.shape[1]
    by_size: dict[int, list[int]] = {}
    for e, (_, rows, shape) in enumerate(layer.entries):
        by_size.setdefault(len(rows) * len(shape.index), []).append(e)
    out = []
    for entries in by_size.values():
        index = [(np.array(layer.entries[e][1])[:, None] * f + layer.entries[e][2].index).reshape(-1) for e in entries]
        weight = [np.tile(layer.entries[e][2].weight, len(layer.entries[e][1])) for e in entries]
        out.append(Block(entries, np.array(index), np.array(weight)))
    return out


class Atlas:
    """Of one situation under one screen (geometry alone, one noise)."""

    def __init__(self, screen: Screen, chart: Chart):
        self.screen, self.chart = screen, chart
        self.layers, self.shares = chart.layers, chart.shares
        self.base = [self._normal(layer, screen) for layer in self.layers]

    def _normal(self, layer: Layer, screen: Screen):
        """S (k, k), b (k,), raw (k,) with geometry projected out."""
        if not layer.per_pose:
            X = self._whitened(layer)
            taken = screen.Q.T @ X
            geometry_free = screen.r0 - screen.Q @ (screen.Q.T @ screen.r0)
            S = X.T @ X
            return S - taken.T @ taken, X.T @ geometry_free, np.diag(S).copy()
        b, A, C = screen.reduced(layer.keys)
        U, mix = layer.functions, layer.mix
        b, A = b @ mix.T, mix @ A @ mix.T
        C = np.einsum("dc,pcz->pdz", mix, C)
        P, c, f = len(U), len(mix), U.shape[1]
        XQ = (U.T @ C.reshape(P, -1)).reshape(f, c, -1).transpose(1, 0, 2).reshape(c * f, -1)
        S = np.empty((c, f, c, f))
        for i in range(c):
            for j in range(i + 1):
                S[i, :, j] = U.T @ (A[:, i, j, None] * U)
                S[j, :, i] = S[i, :, j].T
        S = S.reshape(c * f, c * f)
        raw = np.diag(S).copy()
        return S - XQ @ XQ.T, (U.T @ b).T.reshape(-1), raw

    def _whitened(self, layer: Layer) -> np.ndarray:
        return self.screen.whiten(self._columns(layer, np.arange(layer.components), np.arange(layer.functions.shape[1])))

    def _columns(self, layer: Layer, rows, index) -> np.ndarray:
        """(M, R, rows x index), component-major."""
        linear = self.screen.linear
        unit = np.stack([linear.unit(*key) for key in layer.keys], axis=2) @ layer.mix[np.asarray(rows)].T
        F = layer.functions[:, np.asarray(index)]
        F = F[linear.obs.pose] if layer.per_pose else F
        return (unit[:, :, :, None] * F[:, None, None, :]).reshape(*unit.shape[:2], -1)

    def judge(self, screen: Screen) -> Judged:
        """screen: this atlas' screen, with effects and groups adopted."""
        found: dict[tuple[str, str], Cell] = {}
        at_place: dict[str, list[float]] = {}
        for number, (layer, (S, b, raw)) in enumerate(zip(self.layers, self.base, strict=True)):
            if screen.more.shape[1]:
                taken = self._more(layer, screen)
                S, b = S - taken @ taken.T, b - taken @ screen.taken
            self._weigh(number, layer, S, b, raw, found, at_place)
        count = np.log(len(at_place))
        mean = {at: log_mean(np.array(logs)) for at, logs in at_place.items()}
        ranked = dict(sorted(mean.items(), key=lambda item: -item[1]))
        total = float(np.logaddexp.reduce(list(mean.values())) - count)
        return Judged(sorted(found.values(), key=lambda c: -c.log_ratio), ranked, total)

    def _more(self, layer: Layer, screen: Screen) -> np.ndarray:
        """(k, adopted) products of the layer's columns with what is adopted."""
        if not layer.per_pose:
            return self._whitened(layer).T @ screen.more
        C = np.einsum("dc,pcz->pdz", layer.mix, screen.reduced_more(layer.keys))
        U = layer.functions
        P, c, f = len(U), len(layer.mix), U.shape[1]
        return (U.T @ C.reshape(P, -1)).reshape(f, c, -1).transpose(1, 0, 2).reshape(c * f, -1)

    def _weigh(self, number, layer, S, b, raw, found, at_place) -> None:
        for block in self.chart.blocks[number]:
            index = block.index
            logs, gains, used = log_ratio(S[index[:, :, None], index[:, None, :]], b[index], raw[index], block.weight)
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
                keep(found, Cell(place, on, log, log - self.shares[place], float(gains[j]), float(used[j]), number, rows, shape))

    def group(self, cell: Cell) -> Group:
        """The cell's columns, each of unit size, as a group for the smooth model."""
        layer = self.layers[cell.layer]
        f = layer.functions.shape[1]
        columns = self._columns(layer, cell.rows, cell.shape.index)
        raw = self.base[cell.layer][2][(np.array(cell.rows)[:, None] * f + cell.shape.index).reshape(-1)]
        return Group(cell.at, cell.depends_on, columns / np.sqrt(raw), np.tile(cell.shape.weight, len(cell.rows)))


def keep(found: dict[tuple[str, str], Cell], cell: Cell) -> None:
    key = cell.at, cell.depends_on
    if key not in found or cell.log_ratio > found[key].log_ratio:
        found[key] = cell


def shares(layers: list[Layer]) -> dict[str, float]:
    """Place -> log of one over the prior share of one of its groups."""
    count: dict[str, int] = {}
    for layer in layers:
        for at, _, _ in layer.entries:
            count[at] = count.get(at, 0) + 1
    return {at: float(np.log(n * len(count))) for at, n in count.items()}


def layers(s: Situation) -> list[Layer]:
    common = shapes.of_poses(s)
    out = []
    for place in places.of_arm(s):
        table = Table(list(common.columns), list(common.shapes))
        for frame in {place.frame, max(place.frame - (len(place.mix) > 1), 0)}:
            append(table, shapes.moments(s, frame))
        own, name = s.obs.q[:, place.joint], f"q{place.joint + 1}"
        if np.ptp(own) > 0.02:
            append(table, shapes.turns(own, name))
            if len(place.mix) == 1:
                append(table, shapes.fine(own, name))
        for i in range(s.n if len(place.mix) == 1 else 0):
            if np.ptp(s.obs.q[:, i]) > 0.02:
                append(table, shapes.bends(s.obs.q[:, i], f"q{i + 1}"))
        if len(place.mix) == 1 and np.ptp(s.gravity_torque[:, place.joint]) > 0.02 * np.ptp(s.gravity_torque, axis=0).max() + 1e-9:
            append(table, shapes.bends(s.gravity_torque[:, place.joint], f"gravity_torque_{place.joint + 1}"))
        entries = [(place.at, rows, shape) for rows in place.variants for shape in table.shapes]
        out.append(Layer(len(place.mix), table.values, entries, place.keys, place.mix, True))
    out += of_stations(s)
    out += of_scanner(s) if s.scanner_on_flange else of_instrument(s)
    return out


def append(table: Table, more: Table) -> None:
    start = len(table.columns)
    table.columns += more.columns
    table.shapes += [Shape(shape.depends_on, shape.index + start, shape.weight) for shape in more.shapes]


def of_stations(s: Situation) -> list[Layer]:
    """Each station moving while it is measured: evenly, and bent."""
    table, entries, name = Table(), [], "time" if s.obs.time_s is not None else "pose"
    mine = places.stations(s)
    for k, place in mine:
        here = s.obs.station == k
        clock = np.asarray(s.time if s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0 else s.order, dtype=float)
        x = np.where(here, (clock - clock[here].mean()) / max(float(clock[here].std()), 1e-12), 0.0)
        index = table.add(np.stack([x, np.where(here, x * x, 0.0)], axis=1))
        chosen = [Shape(name, index[:1], np.ones(1)), Shape(name, index, np.array([1.0, 0.5]))]
        entries += [(place.at, rows, shape) for rows in place.variants for shape in chosen if len(shape.index)]
    if not entries:
        return []
    return [Layer(6, table.values, entries, mine[0][1].keys, np.eye(6), True)]


def of_instrument(s: Situation) -> list[Layer]:
    """What an instrument that stands beside the arm measures wrongly, by the place of the target in its own frame."""
    if np.ptp(s.obs.xyz, axis=0).min() == 0:
        return []
    table = shapes.of_volume(s)
    entries = [("scanner", rows, shape) for shape in table.shapes for rows in ((0,), (1,), (2,), (0, 1, 2))]
    return [Layer(3, table.values, entries, tuple(("point", 0, c) for c in range(3)), np.eye(3), False)]


def of_scanner(s: Situation) -> list[Layer]:
    """The measured point by place in the field of view, tilt, time; and each ball of an artefact of several."""
    out, obs, owner = [], s.obs, s.obs.cell.ball_artefact
    if np.ptp(obs.xyz, axis=0).max() > 0:
        table = shapes.of_field(s)
        waves = [(name, ripple.waves(obs.xyz[:, c])) for c, name in enumerate("xy") if np.ptp(obs.xyz[:, c]) > 0]
        for name, values in waves:
            index = table.add(values)
            table.shape(name, index)
            for j in range(0, len(index) - 1, 2):
                table.shape(name, index[j:j + 2])
        variants = ((0,), (1,), (2,), (0, 1), (0, 1, 2))
        entries = [("scanner", rows, shape) for shape in table.shapes for rows in variants if len(rows) * len(shape.index) < 60]
        out.append(Layer(3, table.values, entries, tuple(("point", 0, c) for c in range(3)), np.eye(3), False))
    table, entries = Table(), []
    for k, ball in enumerate(obs.cell.ball_ids):
        seen = obs.ball == k
        if seen.sum() >= 3 and np.sum(owner == owner[k]) >= 3:
            index = table.add(seen)
            entries.append((f"ball{ball}", (0, 1, 2), Shape("x", index, np.ones(len(index)))))
    if entries:
        out.append(Layer(3, table.values, entries, tuple(("ball", 0, c) for c in range(3)), np.eye(3), False))
    return out
