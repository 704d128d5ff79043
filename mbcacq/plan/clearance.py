"""How far the arm stays from itself and from what stands around it, at a pose and along the motion between two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from mbcacq.model.computed_once import ComputedOnce
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


def clearance_of(loaded: LoadedPlan) -> Clearance:
    """The clearance of a plan, which remembers what it has examined."""
    return loaded.computed("clearance", lambda: Clearance(loaded))


class Clearance:
    """Distances in one cell. Surroundings that the plan does not name do not count."""

    def __init__(self, loaded: LoadedPlan) -> None:
        self._loaded, self._chain = loaded, loaded.cell.robot.chain
        self._pairs: dict[str | None, list[Pair]] = {}
        self._spheres: dict[str | None, EnclosingSpheres] = {}
        self._at, self._along = ComputedOnce(), ComputedOnce()

    def at(self, q: np.ndarray, station: str | None) -> Closest:
        """Closest bodies at q (n,) rad, with the artefact at ``station`` (None: put away). Two that are as far apart as can be asked of
        them do not count."""
        return self._at((q.tobytes(), station), lambda: self._closest(q, station))

    def _closest(self, q: np.ndarray, station: str | None) -> Closest:
        pairs, frames = self.pairs(station), self._chain.frames(q[None])
        posture, bound = Posture(frames[0]), self._spheres[station].gaps(frames)[0]
        closest = Closest(np.inf, "", "")
        for k in np.argsort(bound):
            if bound[k] >= closest.distance:
                break
            distance = posture.distance(pairs[k])
            if distance < min(pairs[k].most, closest.distance):
                closest = Closest(distance, pairs[k].a.name, pairs[k].b.name)
        return closest

    def along_segment(self, start: np.ndarray, end: np.ndarray, station: str | None, needed: float) -> Closest | None:
        """A pair of bodies closer than ``needed`` mm somewhere on the straight joint motion, or None if all of it is free.

        The motion is halved until the distance at the middle exceeds what the halves can at most take away, so nothing slips through
        between two examined postures, except within the last ``finest_travel_mm``. The gap of two spheres around the bodies is no more
        than their distance, and is enough for most pairs.
        """
        key = start.tobytes(), end.tobytes(), station, needed
        return self._along(key, lambda: self._examined_segment(start, end, station, needed))

    def _examined_segment(self, start: np.ndarray, end: np.ndarray, station: str | None, needed: float) -> Closest | None:
        pairs = self.pairs(station)
        sweep = (
            np.array([p.lever for p in pairs]).reshape(-1, len(start)) @ np.abs(end - start) / 2
        )  # mm that half of the motion can at most take away
        asked = np.minimum(needed, [p.most for p in pairs])
        step, middles, suspects = 0.5, np.array([0.5]), np.ones((1, len(pairs)), dtype=bool)
        while len(middles):
            frames = self._chain.frames(start + middles[:, None] * (end - start))
            suspects &= self._spheres[station].gaps(frames) < asked + sweep
            postures = [Posture(f) for f in frames]
            for i, k in np.argwhere(suspects):
                distance = postures[i].distance(pairs[k])
                if distance < asked[k]:
                    return Closest(distance, pairs[k].a.name, pairs[k].b.name)
                suspects[i, k] = distance < asked[k] + sweep[k] and sweep[k] > self._loaded.planning.finest_travel_mm / 2
            left, step, sweep = suspects.any(axis=1), step / 2, sweep / 2
            middles = np.concatenate([middles[left] - step, middles[left] + step])
            suspects = np.tile(suspects[left], (2, 1))
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
            self._spheres[station] = EnclosingSpheres(self._pairs[station])
        return self._pairs[station]

    @cached_property
    def _arm(self) -> list[Body]:
        return arm_bodies(self._loaded)

    def _own_pairs(self) -> list[Pair]:
        """All bodies of the arm against each other, except neighbouring links, and what overlaps in each of many random postures.

        The scanner and its carrier are no links, and no joint limit of the maker's keeps them off the arm. If they overlap with a link in
        every posture, they are divided, and only the overlapping parts are left out.
        """
        return [
            p for a, b in combinations(self._arm, 2) if b.link > max(a.link, self._chain.first_turning + 1) for p in self._examined(a, b)
        ]

    @cached_property
    def _random_postures(self) -> list[Posture]:
        robot, count = self._loaded.cell.robot, self._loaded.planning.random_postures
        q = np.random.default_rng(0).uniform(robot.limits[:, 0], robot.limits[:, 1], (count, robot.n))
        return [Posture(frames) for frames in robot.chain.frames(q)]

    def _examined(self, a: Body, b: Body) -> Iterator[Pair]:
        """The pair, or pairs with parts of ``b``, or nothing. At most half of what two bodies can have between them is asked of them."""
        planning, pair, farthest = self._loaded.planning, self._pair(a, b), -np.inf
        for posture in self._random_postures:
            farthest = max(farthest, posture.distance(pair))
            if farthest / 2 > max(self._loaded.plan.clearance_mm, planning.neighbour_gap_mm):
                yield pair
                return
        if b.carried and farthest <= 0:
            if b.length > planning.smallest_part_mm:
                for half in halves(b):
                    yield from self._examined(a, half)
        elif farthest > (0.0 if b.link - a.link > 1 or b.carried else planning.neighbour_gap_mm):
            yield replace(pair, most=farthest / 2)

    def _against(self, body: Body) -> Iterator[Pair]:
        """Standing bodies against all moving ones. A body that touches link 1 at every angle, or what slides it, carries the arm."""
        first = self._chain.first_turning + 1
        for part in self._arm:
            if 0 < part.link <= first:
                yield from self._examined(body, part)
            elif part.link > first:
                yield self._pair(body, part)

    def _pair(self, a: Body, b: Body) -> Pair:
        return Pair(a, b, self._lever(a.link, b))

    def _lever(self, behind: int, body: Body) -> np.ndarray:
        frames = self._chain.frames(np.zeros((1, self._chain.n)))[0]
        steps = np.linalg.norm(np.diff(frames[:, :3, 3], axis=0), axis=1)
        lever = np.zeros(self._chain.n)
        for joint in range(behind, body.link):
            lever[joint] = steps[joint : body.link].sum() + np.linalg.norm(body.pose[:3, 3]) + body.radius
        lever[list(self._chain.sliding)] = 1.0
        return lever


class EnclosingSpheres:
    """The spheres around the bodies of K pairs: how far apart the bodies of a pair at least are, for many postures at once."""

    def __init__(self, pairs: Sequence[Pair]) -> None:
        self._links = np.array([[p.a.link, p.b.link] for p in pairs], dtype=int).reshape(-1, 2)
        self._centres = np.array([[p.a.pose[:, 3], p.b.pose[:, 3]] for p in pairs]).reshape(-1, 2, 4)
        self._radii = np.array([p.a.radius + p.b.radius for p in pairs])

    def gaps(self, frames: np.ndarray) -> np.ndarray:
        """mm (P, K), negative: overlap of the spheres. frames: (P, n + 1, 4, 4)."""
        centres = np.einsum("pkbij,kbj->pkbi", frames[:, self._links], self._centres)
        return np.linalg.norm(centres[:, :, 1] - centres[:, :, 0], axis=-1) - self._radii


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
