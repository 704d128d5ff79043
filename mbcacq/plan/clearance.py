"""How far the arm stays from itself and from what stands around it, at a pose and along the motion between two."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from mbcacq import lazy
from mbcacq.plan.collision import Body, arm_bodies, station_bodies, surrounding_bodies
from mbcacq.plan.planned import LoadedPlan


@dataclass(frozen=True)
class Pair:
    """Two bodies that must not touch. lever: (n,) mm by which a radian of each joint can at most move one against the other."""

    a: Body
    b: Body
    lever: np.ndarray


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
        """Closest bodies at q (n,) rad, with the artefact at ``station`` (None: put away)."""
        posture = Posture(self._chain.frames(q[None])[0])
        pairs = self.pairs(station)
        distances = [posture.distance(p) for p in pairs]
        k = int(np.argmin(distances)) if distances else -1
        return Closest(distances[k], pairs[k].a.name, pairs[k].b.name) if distances else Closest(np.inf, "", "")

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
                distance = posture.distance(pair)
                if distance < needed:
                    return Closest(distance, pair.a.name, pair.b.name)
                if distance - share * sweep < needed and share * sweep > finest / 2:
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
        """All bodies of the arm against each other, except neighbours: those that touch, or nearly, in each of many random postures."""
        robot = self._loaded.cell.robot
        q = np.random.default_rng(0).uniform(robot.limits[:, 0], robot.limits[:, 1], (self._loaded.planning.neighbour_postures, robot.n))
        pairs = [self._pair(a, b) for a, b in combinations(self._arm, 2) if b.link > max(a.link, 1)]
        postures = [Posture(frames) for frames in robot.chain.frames(q)]
        return [p for p in pairs if any(posture.distance(p) > self._loaded.planning.neighbour_gap_mm for posture in postures)]

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
        self._frames, self._fcl = frames, lazy.fcl()
        self._request = self._fcl.DistanceRequest(enable_signed_distance=True)  # overlap as a negative distance
        self._placed: dict[Body, Any] = {}

    def distance(self, pair: Pair) -> float:
        """mm, negative: overlap."""
        between = self._fcl.distance(self._place(pair.a), self._place(pair.b), self._request, self._fcl.DistanceResult())
        return between - pair.a.rounding - pair.b.rounding

    def _place(self, body: Body) -> Any:
        placed = self._placed.get(body)
        if placed is None:
            T = self._frames[body.link] @ body.pose
            placed = self._placed[body] = self._fcl.CollisionObject(body.shape, self._fcl.Transform(T[:3, :3], T[:3, 3]))
        return placed
