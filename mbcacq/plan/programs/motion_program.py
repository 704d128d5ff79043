"""What a robot program does, before it is written in any controller's language: moves by the checked routes, and waits for exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mbcacq.plan.controller_joints import to_controller
from mbcacq.plan.motion_limits import axis_limits, motion_limits
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.timing import motion_time
from mbcacq.quantities import from_degrees

NAME = "mbcacq_poses"  # of every program, and at most 12 characters, as KAREL has them


@dataclass(frozen=True)
class Trigger:
    """How an exposure is asked for at a pose that is reached. kind: 'output' sets a digital output for ``pulse_s``, then waits
    ``exposure_s``; 'pause' only waits; 'key' waits until a person lets the program go on."""

    kind: Literal["output", "pause", "key"] = "output"
    output: int = 1
    pulse_s: float = 0.2
    exposure_s: float = 3.0


@dataclass(frozen=True)
class MoveTo:
    """A joint motion, exact at its end. angles: (n,) deg, mm as the controller counts them; duration_s: at the plan's speed, None if nobody
    knows from where it begins; note: for people."""

    do: ClassVar = "move"
    angles: tuple[float, ...]
    duration_s: float | None
    note: str

    @property
    def radians(self) -> list[float]:
        """(n,) rad."""
        return from_degrees(self.angles).tolist()

    @property
    def written(self) -> list[str]:
        """(n,) deg with six decimals, as tables have them."""
        return [f"{angle + 0.0:.6f}" for angle in self.angles]


@dataclass(frozen=True)
class ExposeAt:
    """The arm stands at a pose. clouds: running numbers, from 1, of the clouds that are taken here."""

    do: ClassVar = "expose"
    pose: int
    station: str
    clouds: tuple[int, ...]


@dataclass(frozen=True)
class PlaceArtefact:
    """The arm stands at home; a person puts the artefact to a station and lets the program go on."""

    do: ClassVar = "place"
    station: str
    artefact: str


@dataclass(frozen=True)
class MotionProgram:
    """One session.

    axes: names, in the order of positions; headings: of these in tables. speed, acceleration: shares of what the axes can do, as in a run.
    speed_rad_s, acceleration_rad_s2: of the slowest axis. digest: of the plan, so that clouds of another one are recognised.
    """

    name: str
    plan: str
    digest: str
    robot: str
    axes: tuple[str, ...]
    headings: tuple[str, ...]
    steps: tuple[MoveTo | ExposeAt | PlaceArtefact, ...]
    trigger: Trigger
    settle_s: float
    speed: float
    acceleration: float
    speed_rad_s: float
    acceleration_rad_s2: float

    @property
    def n(self) -> int:
        return len(self.axes)

    @property
    def external(self) -> int:
        """How many axes are external ones."""
        return sum(name.startswith("E") for name in self.axes)

    def by_name(self, positions: Sequence[float]) -> list[tuple[str, float]]:
        """Positions with the names of their axes, those of the arm first: as KRL has them."""
        return sorted(zip(self.axes, positions, strict=True))

    @property
    def title(self) -> list[str]:
        """What stands at the head of every program."""
        clouds = self.exposures[-1].clouds[-1] if self.exposures else 0
        return [
            f"Plan {plain(self.plan)} ({self.digest}) for {plain(self.robot)}, written by mbcacq.",
            f"{len(self.exposures)} poses, {clouds} clouds; {self.speed_percent} % of the axes' speeds.",
            "Nobody has run this program. First in the slow manual mode, step by step,",
            "a hand on the enabling switch. The load data of the scanner must be set.",
        ]

    @property
    def exposures(self) -> list[ExposeAt]:
        return [step for step in self.steps if isinstance(step, ExposeAt)]

    @property
    def speed_percent(self) -> int:
        """Rounded down, and never 0."""
        return max(1, int(100 * self.speed + 1e-9))

    @property
    def acceleration_percent(self) -> int:
        return max(1, min(100, int(100 * self.acceleration + 1e-9)))


def motion_program(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    paths: Sequence[Transit],
    path_home: Sequence[np.ndarray],
    digest: str,
    *,
    trigger: Trigger | None = None,
    done: frozenset[int] = frozenset(),
) -> MotionProgram:
    """The program of the poses that are not ``done``. paths, path_home: as checked (``mbcacq.plan.routing``); its moves are theirs, in
    their order. Raises ConfigError if the arm has no speeds, or ``controller_joints`` do not fit it."""
    limits, allowed = motion_limits(loaded), axis_limits(loaded)
    steps: list[MoveTo | ExposeAt | PlaceArtefact] = []
    last = home = loaded.plan.robot.home
    station, cloud = None, 0

    def go(q: np.ndarray, note: str) -> None:
        nonlocal last
        angles = tuple(float(a) for a in to_controller(loaded, q))
        steps.append(MoveTo(angles, motion_time(last, q, limits) if steps else None, note))
        last = q

    go(home, "home")
    for pose, path in zip(poses, paths, strict=True):
        if pose.number in done:
            continue
        for waypoint in path.retract:
            go(waypoint, "way")
        if pose.station != station:
            station = pose.station
            steps.append(PlaceArtefact(station, loaded.cell.artefact(pose.artefact).name or pose.artefact))
        for waypoint in path.approach:
            go(waypoint, "way")
        go(pose.q, f"pose {pose.number}")
        steps.append(ExposeAt(pose.number, pose.station, tuple(range(cloud + 1, cloud + pose.exposures + 1))))
        cloud += pose.exposures
    for waypoint in path_home:
        go(waypoint, "home" if waypoint is path_home[-1] else "way")
    acceleration = float(np.min(limits.acceleration / allowed.acceleration))
    return MotionProgram(
        name=NAME,
        plan=loaded.plan.name,
        digest=digest,
        robot=loaded.cell.robot.name,
        axes=loaded.cell.robot.axes,
        headings=loaded.cell.robot.headings,
        steps=tuple(steps),
        trigger=trigger or Trigger(),
        settle_s=loaded.plan.robot.settle_s,
        speed=loaded.plan.robot.speed,
        acceleration=acceleration,
        speed_rad_s=float(np.min(limits.speed)),
        acceleration_rad_s2=float(np.min(limits.acceleration)),
    )


def plain(text: str) -> str:
    """ASCII without quotes or line ends, for comments and texts of any controller."""
    kept = "".join(c if c.isascii() and c.isprintable() and c not in "\"'`;!" else "?" for c in text)
    return " ".join(kept.split())[:60]
