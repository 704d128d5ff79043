"""What the scanner's protocol server asks for: one exposure of the world as it is at this moment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_fakes.world.hooks import Moments
from mbcacq_fakes.world.operator import NOBODY, FakeOperator
from mbcacq_fakes.world.options import FakeOptions, Mishap
from mbcacq_fakes.world.scanner import FringeScanner
from mbcacq_fakes.world.surfaces import Surfaces
from mbcacq_fakes.world.world import SCAN, World

BY_POSE = 1_000_000  # draws of poses, apart from those of arrivals
DRAWS_OF_A_POSE = 1_000  # more than a pose has exposures and arrivals


class ArmReadout(Protocol):
    """The part of ArmState that is read here."""

    def read(self) -> Any: ...


class Camera:
    """Callable as the ``source`` of a scanner server.

    Several exposures at one standstill share the arm's rest position; each has its own scanner noise. clock_start_s: what the
    robot's clock showed when the cell was switched on. poses_before: how many poses were measured in the same cell before it was started
    again, whose draws of noise are not drawn once more.
    """

    def __init__(
        self,
        world: World,
        scanner: FringeScanner,
        operator: FakeOperator,
        arm: ArmReadout,
        options: FakeOptions,
        right_exposure_us: float | None = None,
        clock_start_s: float = 0.0,
        poses_before: int = 0,
    ) -> None:
        self.world, self.scanner, self.operator = world, scanner, operator
        self._arm, self._options, self.clock_start_s = arm, options, clock_start_s
        self._stand: Callable[[], int | None] = lambda: None
        self._mishaps = list(options.mishaps)
        self._right_exposure, self._frames = right_exposure_us, 0
        self._arrivals, self._here = -1, 0
        self._drawn = DRAWS_OF_A_POSE * poses_before
        self._surfaces: Surfaces | None = None  # of the exposure before

    def __call__(self, exposure_us: float = 0.0) -> ScannerFrame:
        reading = self._arm.read()
        self._happen(reading.arrivals)
        at = self.moment(reading)
        moved = self.world.displaced(at)
        covered, bump = self.operator.covered, self.operator.bumps.get(int(at.station[0]))
        scene = self.world.scene(at, moved, covered, bump, self._options.furniture)
        rng = self.world.noise(SCAN, *self._draw(reading))
        if self._surfaces is None or not self._surfaces.scene.equals(scene):
            self._surfaces = self.scanner.surfaces(scene)
        points = self.scanner.expose(self._surfaces, rng, self._brightness(exposure_us))
        points.xyz[:] = self.world.warp(points.xyz, np.zeros(len(points.xyz), dtype=int), at)
        return self.scanner.frame(points, float(reading.time_s))

    def _draw(self, reading: Any) -> tuple[int, ...]:
        """What decides the noise of this exposure: how many came before it; or which pose it is taken at, and how many there."""
        if reading.arrivals != self._arrivals:
            self._arrivals, self._here = reading.arrivals, 0
        self._here += 1
        self._frames += 1
        if self._options.draws == "course":
            return (self._drawn + self._frames - 1,)
        return BY_POSE + self.operator.pose_for(np.array(reading.q)), self._here

    def follow(self, stand: Callable[[], int | None]) -> None:
        """From now on ``stand()`` says which station a positioner has driven to (index, or NOBODY)."""
        self._stand = stand

    def moment(self, reading: Any) -> Moments:
        q = np.array(reading.q)
        station, artefact = self.standing(q)
        arrival = self._drawn + reading.arrivals if self._options.draws == "course" else BY_POSE + self.operator.pose_for(q)
        return self.world.moments(
            q[None],
            np.array(reading.qd)[None],
            np.array(reading.direction)[None],
            np.array([arrival]),
            np.array([self._time(reading)]),
            np.array([station]),
            np.array([artefact]),
        )

    def standing(self, q: np.ndarray) -> tuple[int, int]:
        """Index of the station that is served for an arm at q (n,) rad, and of the artefact that stands there."""
        stand = self._stand()
        station = self.operator.station_for(q) if stand is None else stand
        return station, self.operator.artefact_at(station)

    def temperatures(self) -> dict[str, float]:
        """What the cell's thermometers show now."""
        time_s = self.world.environment.clock(np.array(self._time(self._arm.read())))
        climate = self.world.environment
        return {"air_C": float(climate.air(time_s)), "robot_C": float(climate.robot(time_s)), "scanner_C": float(climate.scanner(time_s))}

    def mishap(self, mishap: Mishap) -> None:
        """Let something go wrong, now or from the arrival it names."""
        self._mishaps.append(mishap)

    def _time(self, reading: Any) -> float:
        return max(reading.time_s - self.clock_start_s, 0.0)

    def _brightness(self, exposure_us: float) -> float:
        """Light relative to the right exposure, which is the plan's, or the first one asked for."""
        if exposure_us <= 0:
            return 1.0
        if self._right_exposure is None:
            self._right_exposure = exposure_us
        return exposure_us / self._right_exposure

    def _happen(self, arrivals: int) -> None:
        due = [m for m in self._mishaps if arrivals >= m.from_arrival]
        self._mishaps = [m for m in self._mishaps if arrivals < m.from_arrival]
        for mishap in due:
            self._apply(mishap)

    def _apply(self, mishap: Mishap) -> None:
        facts, operator = self.world.facts, self.operator
        stations = range(len(facts.station_ids)) if mishap.station is None else [facts.station_ids.index(str(mishap.station))]
        if mishap.kind == "empty_scene":
            operator.empty = True
        elif mishap.kind == "hidden_ball":
            operator.covered.add(int(mishap.ball or 0))
        elif mishap.kind == "bumped_tripod":
            for s in stations:
                operator.bumps[s] = np.concatenate([mishap.shift_mm, np.radians(mishap.rotation_deg)])
        else:
            other = NOBODY if mishap.artefact is None else [a.id for a in facts.artefacts].index(mishap.artefact)
            operator.wrong.update(dict.fromkeys(stations, other))
