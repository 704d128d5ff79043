"""The next visit of a station: which of the views that can be taken decide most of what is open, per second."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.design.adaptive.backward_elimination import SIX, BackwardElimination, MeasuredInformation
from mbcacq.design.adaptive.options import OPTIONS, AdaptiveOptions
from mbcacq.design.adaptive.places import errors_at
from mbcacq.design.adaptive.planned_observations import continued
from mbcacq.design.adaptive.questions import Questions, questions
from mbcacq.design.information_blocks import InformationBlocks
from mbcacq.diagnosis.interim import InterimEvidence
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.model.cell import Station
from mbcacq.plan import PlannedPose


@dataclass(frozen=True)
class VisitCosts:
    """Seconds: of a pose, of moving an artefact, of a look and a choice after a visit; at: the station at which each artefact stands now,
    by artefact.
    """

    pose_s: float
    move_s: float
    at: Mapping[str, str]
    look_s: float = 0.0

    def moves(self, station: Station) -> int:
        """1 where the artefact of a station stands elsewhere."""
        return int(self.at.get(station.artefact) != station.id)

    def seconds(self, station: Station, poses: int) -> float:
        """Time of a visit with so many poses."""
        return self.look_s + self.moves(station) * self.move_s + poses * self.pose_s


@dataclass(frozen=True, kw_only=True)
class Visit:
    """Poses at one station that are measured next.

    Attributes
    ----------
    poses : tuple[PlannedPose, ...]
        To be measured at the station, in this order.
    gain : float
        Log odds between sets that are expected to be gained, as far as they are needed.
    value : float
        The gain with everything else that the visit shows.
    seconds : float
        Time that the visit takes.
    moves : int
        Moves of the artefact, 0 or 1.
    """

    station: str
    poses: tuple[PlannedPose, ...]
    gain: float
    value: float
    seconds: float
    moves: int


@dataclass(frozen=True)
class OpenPair:
    """Two sets of effects that are not told apart. odds: of the second against the first; reachable: log odds that all views that can be
    taken are expected to decide by; held: the same, were the places of the stations known.
    """

    a: tuple[str, ...]
    b: tuple[str, ...]
    odds: float
    reachable: float
    held: float

    @property
    def futile(self) -> bool:
        """Whether no view that can be taken tells them apart."""
        return self.reachable < OPTIONS.enough


class VisitChoice:
    """The choice among the poses of a pool, which can be taken, after a look. stations: of the cell, with planned places. places (m, 3) mm:
    at which the arm is to be accurate.
    """

    def __init__(
        self,
        look: InterimEvidence,
        pool: Sequence[PlannedPose],
        stations: Sequence[Station],
        costs: VisitCosts,
        options: AdaptiveOptions = OPTIONS,
        places: np.ndarray | None = None,
    ):
        linear = _linearised(look, pool, stations)
        self.asked = questions(look, linear, options=options)
        count, kept = look.problem.linear.obs.n_poses, look.full.evidence.linear.keep
        keep = np.r_[kept, np.ones(linear.obs.n_centres - len(kept), dtype=bool)]
        blocks = InformationBlocks.of(linear, self.asked.columns, look.full.noise, keep)
        every = np.arange(len(blocks.Z))
        measured = MeasuredInformation.nothing(blocks.Z.shape[2], blocks.E.shape[2]).with_poses(blocks.select(every[:count]))
        self._before, self._ahead = predicted(measured, blocks.select(every[count:]), self.asked.differences)
        self._pool, self._costs, self._options = list(pool), costs, options
        self._at, self._names = {s.id: s for s in stations}, np.array([p.station for p in pool])
        self._stations = list(dict.fromkeys(self._names.tolist()))
        self._g = linear.geometry.shape[2]
        at_places = errors_at(np.zeros((0, 3)) if places is None else places, linear)
        self._places = np.pad(at_places, ((0, 0), (0, blocks.Z.shape[2] - at_places.shape[1])))
        pairs = slice(0, self.asked.pairs)
        self._known = self.asked.information(self._before.gram[pairs, pairs])
        self.open_pairs = tuple(_open_pairs(self._before, self._ahead, self.asked, self._g, options))

    @property
    def futile(self) -> bool:
        """Whether there are sets of which none is excluded, and nothing reachable tells them apart. An effect needs more than the odds of a
        decision, so the empty set is not excluded while it is among them.
        """
        undecided = [pair for pair in self.open_pairs if not (pair.a and pair.b) or abs(np.log(pair.odds)) < self._options.enough]
        return bool(undecided) and all(pair.futile for pair in undecided)

    def sequence(self, visits: int, poses: int, refused: Callable[[PlannedPose], bool] = lambda pose: False) -> list[Visit]:
        """Visits one after the other, each chosen as if those before had been made: until what is open is expected to be decided, or so
        many visits or poses are reached. refused: whether a chosen pose cannot be measured after all.
        """
        before, costs, free, out = self._before, self._costs, np.ones(len(self._pool), dtype=bool), list[Visit]()
        best_of: dict[str, tuple[Visit, list[int]] | None] = {}
        shortlist = self._shortlist(before, costs)
        while len(out) < visits and (left := poses - sum(len(v.poses) for v in out)) >= self._options.fewest:
            for name in shortlist:
                if name not in best_of:
                    best_of[name] = self._best_at(name, before, costs, free, min(self._options.most, left))
            best, index = max(filter(None, best_of.values()), key=lambda one: one[0].value / one[0].seconds, default=(None, []))
            if best is None:
                break
            bad = [k for k in index if refused(self._pool[k])]
            free[bad or index] = False
            if bad:
                del best_of[best.station]
                continue
            if out and (best.gain < self._options.least_gain if self.open_pairs else best.value < self._options.least_gain):
                break
            out.append(best)
            before = before.with_poses(self._ahead.select(np.array(index)))
            costs = replace(costs, at={**costs.at, self._at[best.station].artefact: best.station})
            best_of.clear()
            shortlist = self._shortlist(before, costs) if len(out) < visits else []
        return out

    @cached_property
    def shown(self) -> frozenset[str]:
        """Effects that could still hide, as ``name:where``, and that all poses of the pool together would show at usual size."""
        after = self._before.with_poses(self._ahead).squares[self.asked.pairs :]
        of: dict[str, list[float]] = {}
        for name, information in zip(self.asked.names, after, strict=True):
            of.setdefault(name, []).append(float(information))
        return frozenset(name for name, each in of.items() if np.median(each) >= self._options.shows)

    def hidden(self, visits: Sequence[Visit]) -> list[str]:
        """Effects, as ``name:where``, that could still hide, those that the visits show best first."""
        index = np.array([k for k, p in enumerate(self._pool) if any(p.number == q.number for v in visits for q in v.poses)], dtype=int)
        after = self._before.with_poses(self._ahead.select(index)).squares if len(index) else self._before.squares
        own = slice(self.asked.pairs, None)
        a, b = np.maximum(after[own], 0.0), np.maximum(self._before.squares[own], 0.0)
        gained = self.asked.weights * (a / (a + self._options.shows) - b / (b + self._options.shows))
        best: dict[str, float] = {}
        for name, gain in zip(self.asked.names, gained, strict=True):
            best[name] = best.get(name, 0.0) + float(gain)
        return [name for name, gain in sorted(best.items(), key=lambda one: -one[1]) if gain > 0]

    def _shortlist(self, before: MeasuredInformation, costs: VisitCosts) -> list[str]:
        """The stations of which all views together are worth most per second of a whole visit."""
        if len(self._stations) <= self._options.stations:
            return self._stations

        def value(measured: MeasuredInformation) -> float:
            gram, variance = measured.gram, measured.variance(self._places[:, : measured.N.shape[0]])
            accuracy = -self._options.places * float(np.log(variance)) if variance else 0.0
            return float(self.asked.value(gram[: self.asked.pairs, : self.asked.pairs], np.diag(gram), self._known)) + accuracy

        base, rate = value(before), dict[str, float]()
        for name in self._stations:
            own, ahead = self._of_one_station(before, np.flatnonzero(self._names == name))
            after = value(own.with_poses(ahead))
            rate[name] = (after - base) / costs.seconds(self._at[name], self._options.most)
        return sorted(self._stations, key=lambda name: -rate[name])[: self._options.stations]

    def _best_at(
        self, name: str, before: MeasuredInformation, costs: VisitCosts, free: np.ndarray, most: int
    ) -> tuple[Visit, list[int]] | None:
        """The best visit of a station, with the indices of its poses; None if too few poses are left."""
        here = np.flatnonzero((self._names == name) & free)
        if len(here) < self._options.fewest:
            return None
        station = self._at[name]
        chosen, gain, value = self._of_station(before, here, costs, station, most)
        index = [int(here[k]) for k in chosen]
        poses = tuple(self._pool[k] for k in index)
        return Visit(
            station=name, poses=poses, gain=gain, value=value, seconds=costs.seconds(station, len(index)), moves=costs.moves(station)
        ), index

    def _of_one_station(self, before: MeasuredInformation, here: np.ndarray) -> tuple[MeasuredInformation, InformationBlocks]:
        """What is known, and poses (indices) of one station, in the parameters that these poses depend on: a few times fewer than all. Its
        rounded form ranks stations; poses are left out in all parameters.
        """
        ahead, g = self._ahead.select(here), self._g
        places = np.flatnonzero(np.any(ahead.Z[:, :, g:] != 0.0, axis=(0, 1)))
        if not len(places):
            return before, ahead
        block = slice(g + SIX * int(places[0] // SIX), g + SIX * int(places[0] // SIX) + SIX)
        return before.of_block(g, block), InformationBlocks(np.concatenate([ahead.Z[:, :, :g], ahead.Z[:, :, block]], axis=2), ahead.E)

    def _of_station(
        self, before: MeasuredInformation, here: np.ndarray, costs: VisitCosts, station: Station, most: int
    ) -> tuple[list[int], float, float]:
        """Poses of one station, by elimination of all others. Their number is the permitted one with most value per second. Also returns
        the log odds that they are expected to gain between sets, and their value.
        """
        asked, pairs = self.asked, slice(0, self.asked.pairs)
        elimination = BackwardElimination(before, self._ahead.select(here), asked.pairs)
        gram = before.gram
        products, squares = gram[pairs, pairs], np.diag(gram)
        base, log_odds_gained = float(asked.value(products, squares, self._known)), float(asked.log_odds_gained(products, self._known))
        J, variance = self._places, before.variance(self._places)
        best, rate = ([], 0.0, 0.0), -np.inf
        while True:
            count = int(elimination.left.sum())
            value = float(asked.value(elimination.products, elimination.squares, self._known)) - base
            if variance:
                value += self._options.places * float(np.log(variance / elimination.variance(J)))
            seconds = costs.seconds(station, count)
            if count <= most and value / seconds > rate:
                rate = value / seconds
                best = list(elimination), float(asked.log_odds_gained(elimination.products, self._known)) - log_odds_gained, value
            if count <= self._options.fewest:
                return best
            index, products, missed = elimination.missed()
            left = asked.value(elimination.products - products, elimination.squares - missed, self._known)
            if variance:
                left = left - self._options.places * np.log(elimination.variance_without(J))
            for k in np.argsort(-left, kind="stable")[: max((count - most) // 3, 1)]:
                elimination.remove(int(index[k]))


def _linearised(look: InterimEvidence, pool: Sequence[PlannedPose], stations: Sequence[Station]) -> LinearProblem:
    """The cell as it is known after a look, at measured poses and at those of the pool."""
    obs, state = look.problem.linear.obs, look.full.evidence.linear.state
    old = {s.id: i for i, s in enumerate(obs.cell.stations)}
    new = tuple(replace(s, T_base_station=None, sigma_mm=None) for s in stations if s.id not in old)
    obs = replace(obs, cell=replace(obs.cell, stations=(*obs.cell.stations, *new)))
    planned = {s.id: s.planned_pose for s in stations}
    standing = {obs.cell.stations[i].id for i in np.unique(obs.station)}
    places = [state.T_base_station[old[s.id]] if s.id in standing else planned.get(s.id, np.eye(4)) for s in obs.cell.stations]
    state = replace(state, T_base_station=np.stack(places))
    return LinearProblem.of(continued(obs, state, pool), state)


def predicted(measured: MeasuredInformation, ahead: InformationBlocks, apart: np.ndarray) -> tuple[MeasuredInformation, InformationBlocks]:
    """The same, with the columns (indices) by which two fits differ as the difference of their predictions for the poses ahead. Each fit
    has its own geometry, and both rest on the measured poses.
    """
    B, products, E = measured.B.copy(), measured.products.copy(), ahead.E.copy()
    E[:, :, apart] -= ahead.Z @ np.linalg.solve(measured.N, B[:, apart])
    B[:, apart] = 0.0
    products[apart] = 0.0
    products[:, apart] = 0.0
    return MeasuredInformation(measured.N, B, products), InformationBlocks(ahead.Z, E)


def _open_pairs(
    before: MeasuredInformation, ahead: InformationBlocks, asked: Questions, g: int, options: AdaptiveOptions
) -> list[OpenPair]:
    """What is to be told apart, with the log odds that are within reach. g: free parameters of the geometry, without the stations."""
    if not asked.comparisons:
        return []
    pairs = slice(0, asked.pairs)
    much = InformationBlocks(np.sqrt(options.repeats) * ahead.Z, np.sqrt(options.repeats) * ahead.E)
    after = before.with_poses(much)
    fixed = MeasuredInformation(after.N[:g, :g], after.B[:g], after.products)
    now, then, held = (asked.information(m.gram[pairs, pairs]) for m in (before, after, fixed))
    out: dict[tuple[int, int], OpenPair] = {}
    for j, comparison in enumerate(asked.comparisons):
        if comparison.known >= options.enough:
            continue  # decided as it stands
        first, second = sorted((comparison.a, comparison.b))
        a, b = asked.sets[first], asked.sets[second]
        reachable, would = (comparison.known + 0.5 * float(d[j] - now[j]) for d in (then, held))
        old = out.get((first, second))
        if old is not None:
            reachable, would = min(old.reachable, reachable), min(old.held, would)
        here, there = (tuple(dict.fromkeys(m.label for m in one.members)) for one in (a, b))
        odds = float(np.exp(min(b.log_posterior - a.log_posterior, 50.0)))
        out[first, second] = OpenPair(here, there, odds, reachable, would)
    return list(out.values())
