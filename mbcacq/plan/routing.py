"""The path from pose to pose: straight in joint space where that is free, else by a retraction or by home."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbcacq.errors import ConfigError, SafetyStop
from mbcacq.geometry import se3
from mbcacq.model.computed_once import ComputedOnce
from mbcacq.plan.clearance import Closest, clearance_of
from mbcacq.plan.inverse_kinematics import inverse_kinematics
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit


@dataclass(frozen=True)
class Obstructed:
    """No free path was found to pose ``number``, or from it to home (``homewards``); closest: where the straight one fails."""

    number: int
    closest: Closest
    homewards: bool = False


Routes = tuple[list[Transit], list[Obstructed]]


def path(loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int] = frozenset()) -> list[Transit]:
    """One transit a pose, free of collisions as far as the plan knows the cell.

    It goes by home if the station changes, so that the artefact can be moved. done: numbers of poses to pass over (a resumed run); their
    transits are empty. The path to the first pose that is not done starts at home, and every pose is approached from the one before it,
    even if that is done. Gears then arrive from the same side as in an undisturbed run. Raises ConfigError naming the step of the first
    pose to which no free path was found.
    """
    through = {a.number for a, b in pairwise(poses) if a.number in done and b.number not in done and a.station == b.station}
    left = [p for p in poses if p.number not in done or p.number in through]
    found, obstructed = find_paths(loaded, left)
    if obstructed:
        raise ConfigError(obstructed_sentence(loaded, left, obstructed[0]))
    by_number, out = dict(zip((p.number for p in left), found, strict=True)), []
    for before, pose in zip([None, *poses], poses, strict=False):
        transit = by_number[pose.number] if pose.number not in done else Transit()
        if before is not None and before.number in through and pose.number not in done:
            first = by_number[before.number]
            transit = Transit([*first.retract, *transit.retract], [*first.approach, before.q, *transit.approach])
        out.append(transit)
    return out


def path_home(loaded: LoadedPlan, pose: PlannedPose) -> list[np.ndarray]:
    """Joint waypoints from a pose to home, home included; the straight path where no free one was found."""
    router = router_of(loaded)
    return router.retract(pose) or [router.home]


def check_start(loaded: LoadedPlan, q: np.ndarray) -> None:
    """The first motion of a run goes straight from where the arm stands, q (n,) rad, to home. Raises SafetyStop if that is not free."""
    router = router_of(loaded)
    needed = min(loaded.plan.clearance_mm, router.clearance.at(q, None).distance - 1.0)  # an arm that stands too close may move away
    near = router.clearance.along_segment(q, router.home, None, needed)
    if near is not None:
        angles = ", ".join(f"{a:.1f}" for a in loaded.cell.robot.shown(q))
        raise SafetyStop(
            f"the arm stands at {angles}°; on its straight way to home {near.a} would come within {near.distance:.0f} mm "
            f"of {near.b}; bring it near home by hand, then start again"
        )


def find_paths(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Routes:
    """Transits to all poses, straight where no free path was found, and which those are; the path home from the last is examined too."""
    router = router_of(loaded)
    transits, obstructed = [], []
    for before, pose in zip([None, *poses], poses, strict=False):
        if before is not None and before.station == pose.station:
            retract, approach = [], router.between(before, pose)
        else:
            retract = [] if before is None else router.retract(before)
            approach = router.approach(pose)
        if retract is None and before is not None:
            obstructed.append(Obstructed(before.number, router.obstruction(before.q, router.home, before.station), homewards=True))
        if approach is None:
            start = router.home if before is None or before.station != pose.station else before.q
            obstructed.append(Obstructed(pose.number, router.obstruction(start, pose.q, pose.station)))
        if pose.sweep is not None and not router.sweeps_freely(pose):
            obstructed.append(Obstructed(pose.number, router.obstruction(pose.q, pose.sweep, pose.station)))
        transits.append(Transit(retract if retract is not None else [router.home], approach or []))
    if poses and router.retract(poses[-1]) is None:
        closest = router.obstruction(poses[-1].q, router.home, poses[-1].station)
        obstructed.append(Obstructed(poses[-1].number, closest, homewards=True))
    return transits, obstructed


def obstructed_sentence(loaded: LoadedPlan, poses: Sequence[PlannedPose], obstructed: Obstructed) -> str:
    """'file:line: ...' about a pose to or from which no free path was found."""
    pose = next(p for p in poses if p.number == obstructed.number)
    near = obstructed.closest
    way = f"home from pose {pose.number}" if obstructed.homewards else f"to pose {pose.number}"
    return (
        f"{loaded.path}:{pose.line}: step '{pose.step_name}' at station '{pose.station}': no free path {way} was found "
        f"(on the straight one {near.a} comes within {near.distance:.0f} mm of {near.b}); move the station, or put a view between"
    )


def router_of(loaded: LoadedPlan) -> Router:
    """The router of a plan, which remembers the paths that it has found."""
    return loaded.computed("router", lambda: Router(loaded))


class Router:
    """Finds free paths in one cell. Each of them is a list of joint waypoints (n,) rad; None: no free one was found."""

    def __init__(self, loaded: LoadedPlan) -> None:
        self._loaded = loaded
        self._found = ComputedOnce()
        self.home = loaded.plan.robot.home
        self.clearance = clearance_of(loaded)
        self._needed = loaded.plan.clearance_mm
        self.solver = inverse_kinematics(loaded.cell.robot, self.home, free=loaded.plan.robot.free_axes)

    def between(self, a: PlannedPose, b: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from a to b, both looking at the artefact of one station."""

        def candidates() -> Iterator[list[np.ndarray]]:
            yield []
            back = list(zip(self._retracted(a.q), self._retracted(b.q), strict=False))
            yield from ([x, y] for x, y in back)
            yield [self.home]
            yield from ([x, self.home, y] for x, y in back)

        return self._first_free(a.q, b.q, candidates(), a.station)

    def retract(self, pose: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from a pose to home, home included."""
        waypoints = self._first_free(pose.q, self.home, self._straight_or_retracted(pose), pose.station)
        return None if waypoints is None else [*waypoints, self.home]

    def approach(self, pose: PlannedPose) -> list[np.ndarray] | None:
        """Waypoints from home to a pose, home left out."""
        return self._first_free(self.home, pose.q, self._straight_or_retracted(pose), pose.station)

    def sweeps_freely(self, pose: PlannedPose) -> bool:
        """Whether nothing comes too close on the straight joint motion of a sweep."""
        return pose.sweep is None or self._free([pose.q, pose.sweep], pose.station)

    def obstruction(self, start: np.ndarray, end: np.ndarray, station: str) -> Closest:
        """What is too close on the straight motion, or, where that is free, closest at its end."""
        return self.clearance.along_segment(start, end, station, self._needed) or self.clearance.at(end, station)

    def _first_free(
        self, start: np.ndarray, end: np.ndarray, candidates: Iterable[list[np.ndarray]], station: str
    ) -> list[np.ndarray] | None:
        # A pose that itself is too close spoils every path to it: that is said once, by the check of the poses.
        free = (w for w in candidates if self._free([start, *w, end], station))
        return self._found((station, start.tobytes(), end.tobytes()), lambda: next(free, None))

    def _free(self, stops: list[np.ndarray], station: str) -> bool:
        return all(self.clearance.along_segment(x, y, station, self._needed) is None for x, y in pairwise(stops))

    def _straight_or_retracted(self, pose: PlannedPose) -> Iterator[list[np.ndarray]]:
        yield []
        yield from ([x] for x in self._retracted(pose.q))

    def _retracted(self, q: np.ndarray) -> Iterator[np.ndarray]:
        """Positions on the same branch of the arm, drawn back along the scanner's axis."""
        T = self._loaded.cell.robot.chain.flange(q[None])[0]
        axis = T[:3, :3] @ self._loaded.cell.T_flange_scanner[:3, 2]
        for step in self._loaded.planning.retractions_mm:
            nearest = self.solver.nearest(se3.transform(T[:3, :3], T[:3, 3] + step * axis), q)
            if nearest is not None and np.abs(nearest - q).max() < self._loaded.planning.farthest_retraction:
                yield nearest
