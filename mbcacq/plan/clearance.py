"""How far the arm stays from itself and from what stands around it, at a pose and along the motion between two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from mbcacq.plan.collision import Body, arm_bodies, halves, station_bodies, surrounding_bodies
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.solid_distance import SolidDistance

DISTANCE = SolidDistance()


@dataclass(frozen=True)
class Pair:
    """Two bodies that must not touch. lever: (n,) mm by which a radian of each joint can at most move one against the other.
    most: mm, more is never asked of the two, which are near each other in every posture."""

    a: Body
    b: Body
    lever: np.ndarray
    most: float = np.inf


@dataclass(frozen=True)
class Closest:
    """The least distance (mm, negative: overlap) and the names of the two bodies."""

    distance: float
    a: str
    b: str


class Clearance:
    """Distances in one cell. Surroundings that the plan does not name do not count."""

    def __init__(self, loaded: LoadedPlan) -> None:
        self._loaded, self._chain = loaded, loaded.cell.robot.chain
        self._pairs: dict[str | None, list[Pair]] = {}

    def at(self, q: np.ndarray, station: str | None) -> Closest:
        """Closest bodies at q (n,) rad, with the artefact at ``station`` (None: put away). Two that are as far apart as can be asked of
        them do not count."""
        posture = Posture(self._chain.frames(q[None])[0])
        distances = [(posture.distance(p), p) for p in self.pairs(station)]
        distance, pair = min(((d, p) for d, p in distances if d < p.most), key=lambda found: found[0], default=(np.inf, None))
        return Closest(distance, "" if pair is None else pair.a.name, "" if pair is None else pair.b.name)

    def along_segment(self, start: np.ndarray, end: np.ndarray, station: str | None, needed: float) -> Closest | None:
        """A pair of bodies closer than ``needed`` mm somewhere on the straight joint motion, or None if all of it is free.

        The motion is halved until the distance at the middle exceeds what the halves can at most take away, so nothing slips through
        between two examined postures, except within the last ``finest_travel_mm``.
        """
        travel, finest = np.abs(end - start), self._loaded.planning.finest_travel_mm
        stack = [(0.0, 1.0, [(p, float(p.lever @ travel) / 2) for p in self.pairs(station)])]
        while stack:
            low, high, suspects = stack.pop()
            posture = Posture(self._chain.frames((start + (low + high) / 2 * (end - start))[None])[0])
            share, close = high - low, []
            for pair, sweep in suspects:
                distance, asked = posture.distance(pair), min(needed, pair.most)
                if distance < asked:
                    return Closest(distance, pair.a.name, pair.b.name)
                if distance - share * sweep < asked and share * sweep > finest / 2:
                    close.append((pair, sweep))
            if close:
                middle = (low + high) / 2
                stack += [(middle, high, close), (low, middle, close)]
        return None

    def pairs(self, station: str | None) -> list[Pair]:
        """All pairs to examine, with the artefact at ``station`` (None: put away)."""
        if station not in self._pairs:
            if station is None:
                around = surrounding_bodies(self._loaded)
                self._pairs[None] = self._own_pairs() + [p for body in around for p in self._against(body)]
            else:
                standing = station_bodies(self._loaded, station)
                self._pairs[station] = self.pairs(None) + [p for body in standing for p in self._against(body)]
        return self._pairs[station]

    @cached_property
    def _arm(self) -> list[Body]:
        return arm_bodies(self._loaded)

    def _own_pairs(self) -> list[Pair]:
        """All bodies of the arm against each other, except neighbouring links, and what overlaps in each of many random postures.

        The scanner and what carries it are no links, and no joint limit of the maker's keeps them off the arm: where they overlap with a
        link in every posture, they are divided, and only those parts of them are left out that do.
        """
        robot, planning = self._loaded.cell.robot, self._loaded.planning
        q = np.random.default_rng(0).uniform(robot.limits[:, 0], robot.limits[:, 1], (planning.random_postures, robot.n))
        postures = [Posture(frames) for frames in robot.chain.frames(q)]
        bodies = combinations(self._arm, 2)
        return [p for a, b in bodies if b.link > max(a.link, 1) for p in self._examined(a, b, postures)]

    def _examined(self, a: Body, b: Body, postures: Sequence[Posture]) -> Iterator[Pair]:
        """The pair, or pairs with parts of ``b``, or nothing."""
        planning, pair, farthest = self._loaded.planning, self._pair(a, b), -np.inf
        for posture in postures:
            farthest = max(farthest, posture.distance(pair))
            if farthest > max(self._loaded.plan.clearance_mm, planning.neighbour_gap_mm):
                yield pair
                return
        if b.carried and farthest <= 0:
            if b.length > planning.smallest_part_mm:
                for half in halves(b):
                    yield from self._examined(a, half, postures)
        elif farthest > (0.0 if b.link - a.link > 1 or b.carried else planning.neighbour_gap_mm):
            yield replace(pair, most=farthest / 2)

    def _against(self, body: Body) -> list[Pair]:
        """What stands still, against all that moves; link 1 turns on the spot, where the arm is bolted down."""
        return [self._pair(body, part) for part in self._arm if part.link >= 2]

    def _pair(self, a: Body, b: Body) -> Pair:
        return Pair(a, b, self._lever(a.link, b))

    def _lever(self, behind: int, body: Body) -> np.ndarray:
        frames = self._chain.frames(np.zeros((1, self._chain.n)))[0]
        steps = np.linalg.norm(np.diff(frames[:, :3, 3], axis=0), axis=1)
        lever = np.zeros(self._chain.n)
        for joint in range(behind, body.link):
            lever[joint] = steps[joint : body.link].sum() + np.linalg.norm(body.pose[:3, 3]) + body.radius
        return lever


class Posture:
    """Bodies placed for one posture, each only once. frames: (n + 1, 4, 4)."""

    def __init__(self, frames: np.ndarray) -> None:
        self._frames = frames
        self._placed: dict[Body, np.ndarray] = {}

    def distance(self, pair: Pair) -> float:
        """mm, negative: overlap."""
        return DISTANCE(pair.a, self._place(pair.a), pair.b, self._place(pair.b))

    def _place(self, body: Body) -> np.ndarray:
        placed = self._placed.get(body)
        if placed is None:
            placed = self._placed[body] = self._frames[body.link] @ body.pose
        return placed
