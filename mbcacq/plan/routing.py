"""The way from pose to pose: straight in joint space where that is free, else by a detour."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbcacq.errors import ConfigError, SafetyStop
from mbcacq.geometry import se3
from mbcacq.plan.clearance import Clearance, Closest
from mbcacq.plan.kinematics import InverseKinematics
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit

RETRACTIONS_MM = (80.0, 160.0, 260.0)  # along the scanner's axis, away from what it looks at
FARTHEST = np.radians(75.0)  # joint travel of a retraction; more means another branch of the arm


@dataclass(frozen=True)
class Obstructed:
    """No free way was found to pose ``number``; closest: where the straight one fails."""

    number: int
    closest: Closest


def path(loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int] = frozenset()) -> list[Transit]:
    """One transit a pose; where the station changes, by way of home, so that the artefact can be moved. The way to the first pose that is
    not done starts at home, and every pose is come to from the one before it, even if that is done: gears then arrive from the same side
    as in an undisturbed run. Raises ConfigError naming the step of the first pose to which no free way was found."""
    through = {a.number for a, b in pairwise(poses) if a.number in done and b.number not in done and a.station == b.station}
    left = [p for p in poses if p.number not in done or p.number in through]
    transits, obstructed = find_paths(loaded, left)
    if obstructed:
        raise ConfigError(obstructed_sentence(loaded, left, obstructed[0]))
    ways, by_number = dict(zip((p.number for p in left), transits, strict=True)), []
    for before, pose in zip([None, *poses[:-1]], poses, strict=True):
        way = ways[pose.number] if pose.number not in done else Transit()
        if before is not None and before.number in through and pose.number not in done:
            first = ways[before.number]
            way = Transit([*first.leave, *way.leave], [*first.approach, before.q, *way.approach])
        by_number.append(way)
    return by_number


def way_home(loaded: LoadedPlan, pose: PlannedPose) -> list[np.ndarray]:
    """Joint waypoints from a pose to home, home included; the straight way where no free one was found."""
    router = Router(loaded)
    return router.leave(pose) or [router.home]


def check_start(loaded: LoadedPlan, q: np.ndarray) -> None:
    """The first motion of a run goes straight from where the arm stands, q (n,) rad, to home. Raises SafetyStop if that is not free."""
    router = Router(loaded)
    near = router.clearance.on_way(q, router.home, None, min(loaded.plan.clearance_mm, router.clearance.at(q, None).distance - 1.0))
    if near is not None:
        angles = ", ".join(f"{a:.1f}" for a in np.degrees(q))
        raise SafetyStop(
            f"the arm stands at {angles} deg; on its straight way to home {near.a} would come within {near.distance:.0f} mm "
            f"of {near.b}; bring it near home by hand, then start again"
        )


Routes = tuple[list[Transit], list[Obstructed]]


def find_paths(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Routes:
    """Transits to all poses, straight where no free way was found, and which those are."""
    router = Router(loaded)
    transits, obstructed = [], []
    for before, pose in zip([None, *poses[:-1]], poses, strict=True):
        if before is not None and before.station == pose.station:
            leave, approach = [], router.between(before, pose)
        else:
            leave = [] if before is None else router.leave(before)
            approach = router.approach(pose)
        if leave is None or approach is None:
            start = router.home if before is None or before.station != pose.station else before.q
            obstructed.append(Obstructed(pose.number, router.blocked(start, pose.q, pose.station)))
            leave, approach = leave if leave is not None else [router.home], approach or []
        transits.append(Transit(leave, approach))
    return transits, obstructed


def obstructed_sentence(loaded: LoadedPlan, poses: Sequence[PlannedPose], blocked: Obstructed) -> str:
    pose = next(p for p in poses if p.number == blocked.number)
    near = blocked.closest
    return (
        f"{loaded.path}:{pose.line}: step '{pose.step_name}' at station '{pose.station}': no free way to pose {pose.number} was found "
        f"(on the straight one {near.a} comes within {near.distance:.0f} mm of {near.b}); move the station, or put a view between"
    )


class Router:
    """Finds free ways in one cell."""

    def __init__(self, loaded: LoadedPlan) -> None:
        self._loaded = loaded
        self.home = np.radians(loaded.plan.robot.home_deg)
        self.clearance = Clearance(loaded)
        self._needed = loaded.plan.clearance_mm
        try:
            self._solver: InverseKinematics | None = InverseKinematics.of(loaded.cell.robot)
        except ConfigError:
            self._solver = None  # taught poses of another kind of arm: no retraction, only by home

    def between(self, a: PlannedPose, b: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from a to b, both looking at the artefact of one station; None: no free way."""

        def ways() -> Iterator[list[np.ndarray]]:
            yield []
            back = list(zip(self._retracted(a.q), self._retracted(b.q), strict=False))
            yield from ([x, y] for x, y in back)
            yield [self.home]
            yield from ([x, self.home, y] for x, y in back)

        return self._first_free(a.q, b.q, ways(), a.station)

    def leave(self, pose: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from a pose to home, home included."""
        way = self._first_free(pose.q, self.home, self._straight_or_back(pose), pose.station)
        return None if way is None else [*way, self.home]

    def approach(self, pose: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from home to a pose, home left out."""
        return self._first_free(self.home, pose.q, self._straight_or_back(pose), pose.station)

    def blocked(self, start: np.ndarray, end: np.ndarray, station: str) -> Closest:
        return self.clearance.on_way(start, end, station, self._needed) or self.clearance.at(end, station)

    def _first_free(self, start: np.ndarray, end: np.ndarray, ways: Iterable[list[np.ndarray]], station: str) -> list[np.ndarray] | None:
        # A pose that itself is too close spoils every way to it: that is said once, by the check of the poses.
        for way in ways:
            stops = [start, *way, end]
            if all(self.clearance.on_way(x, y, station, self._needed) is None for x, y in pairwise(stops)):
                return way
        return None

    def _straight_or_back(self, pose: PlannedPose) -> Iterator[list[np.ndarray]]:
        yield []
        yield from ([x] for x in self._retracted(pose.q))

    def _retracted(self, q: np.ndarray) -> Iterator[np.ndarray]:
        if self._solver is None:
            return
        T = self._loaded.cell.robot.chain.flange(q[None])[0]
        axis = T[:3, :3] @ self._loaded.cell.T_flange_scanner[:3, 2]
        for step in RETRACTIONS_MM:
            found = self._solver.solutions(se3.transform(T[:3, :3], T[:3, 3] + step * axis)[None])[0]
            if len(found):
                nearest = found[np.argmin(np.abs(found - q).max(axis=1))]
                if np.abs(nearest - q).max() < FARTHEST:
                    yield nearest
