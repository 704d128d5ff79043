"""The cell as it truly is: the nominal cell plus errors, draws and injected effects, and what of it the scanner measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbcacq_fakes.world.arm import TrueArm, paper_errors
from mbcacq_fakes.world.artefact import TrueArtefact, make
from mbcacq_fakes.world.description import CellFacts
from mbcacq_fakes.world.environment import Environment
from mbcacq_fakes.world.hooks import Moments, Moved, WorldEffect
from mbcacq_fakes.world.rigid import carry, displacement, invert
from mbcacq_fakes.world.scanner import Scene

ARRIVAL, POSITIONS, BALLS, EFFECTS, SCAN = range(5)  # independent random streams of one seed


@dataclass(frozen=True)
class Deviations:
    """How far the true cell is from the plan. errors: (n, 5) of the MD-H rows in rad, mm. repeatability: (n,) rad, one draw an
    arrival. hand_eye: true T_flange_scanner (4, 4), or None for the guess moved by a draw of the given sigmas (per axis, cut at 2).
    """

    errors: np.ndarray
    repeatability: np.ndarray
    hand_eye: np.ndarray | None = None
    hand_eye_mm: float = 1.5
    hand_eye_rad: float = np.radians(0.4)
    station_mm: float = 1.5
    station_rad: float = np.radians(0.4)

    @classmethod
    def default(cls, n: int) -> Deviations:
        """Table 1 of the paper for a six-axis arm (repeated or cut for another), 5 urad of joint repeatability."""
        errors = np.zeros((n, 5))
        table = paper_errors()
        errors[: min(n, 6)] = table[: min(n, 6)]
        return cls(errors, np.full(n, 5e-6))


@dataclass
class World:
    """Everything true. ``seed`` decides every draw; two worlds of equal arguments are equal. noise_seed: where it is given, it decides
    what differs between two runs of one cell (where joints come to rest, what the scanner scatters)."""

    facts: CellFacts
    deviations: Deviations
    effects: Sequence[WorldEffect] = ()
    environment: Environment = field(default_factory=Environment)
    seed: int = 0
    noise_seed: int | None = None

    def __post_init__(self) -> None:
        self.arm = TrueArm.from_rows(self.facts.sign, self.facts.rows + self.deviations.errors, self.facts.slides, self.facts.root)
        positions = np.random.default_rng([self.seed, POSITIONS])
        d = self.deviations
        drawn = self.facts.hand_eye @ _offset(positions, d.hand_eye_mm, d.hand_eye_rad)
        self.hand_eye = drawn if d.hand_eye is None else np.asarray(d.hand_eye, dtype=float)
        self.stations = np.array([T @ _offset(positions, d.station_mm, d.station_rad) for T in self.facts.station_pose])
        balls = np.random.default_rng([self.seed, BALLS])
        self.artefacts: tuple[TrueArtefact, ...] = tuple(make(a, balls) for a in self.facts.artefacts)
        self.first_ball = np.cumsum([0, *(len(a.balls) for a in self.artefacts)])
        true_facts = self.facts
        for effect in self.effects:
            true_facts = effect.alter(true_facts)
        for k, effect in enumerate(self.effects):
            effect.begin(true_facts, self.arm, np.random.default_rng([self.seed, EFFECTS, k]))

    def moments(
        self,
        q: np.ndarray,
        velocity: np.ndarray,
        direction: np.ndarray,
        arrival: np.ndarray,
        robot_time_s: np.ndarray,
        station: np.ndarray,
        artefact: np.ndarray,
    ) -> Moments:
        """Add clock and temperatures to what the arm and the operator do; all with a leading axis P, in time order."""
        time_s = self.environment.clock(robot_time_s)
        air_C, robot_C = self.environment.air(time_s), self.environment.robot(time_s)
        return Moments(q, velocity, direction, arrival, time_s, air_C, robot_C, station=station, artefact=artefact)

    def displaced(self, at: Moments) -> Moved:
        """What all effects do at these moments."""
        moved = Moved.nothing(len(at), self.facts.n, len(self.facts.balls))
        for effect in self.effects:
            effect.displace(at, moved)
        return moved

    def noise(self, *stream: int) -> np.random.Generator:
        """The draws of one independent stream of a run's noise."""
        return np.random.default_rng([self.seed if self.noise_seed is None else self.noise_seed, *stream])

    def repeatability(self, arrival: np.ndarray) -> np.ndarray:
        """(P, n) rad: where the joints really came to rest, a fresh draw for each number of arrivals."""
        draws = {int(a): self.noise(ARRIVAL, int(a)).standard_normal(self.facts.n) for a in np.unique(arrival)}
        return np.array([draws[int(a)] for a in arrival]).reshape(-1, self.facts.n) * self.deviations.repeatability

    def scanner_pose(self, at: Moments, moved: Moved) -> np.ndarray:
        """T_base_scanner (P, 4, 4)."""
        q = at.q + moved.joint + self.repeatability(at.arrival)
        return self.arm.frames(q, moved.frame)[:, -1] @ self.hand_eye

    def artefact_pose(self, at: Moments, moved: Moved) -> np.ndarray:
        """T_base_artefact (P, 4, 4)."""
        return self.stations[at.station] @ displacement(moved.station[:, :3], moved.station[:, 3:])

    def balls_in_scanner(self, at: Moments, moved: Moved, artefact: int) -> np.ndarray:
        """(P, B, 3) mm: true centres of an artefact's balls in the scanner frame, were it the one that stands there."""
        T = invert(self.scanner_pose(at, moved)) @ self.artefact_pose(at, moved)
        own = slice(self.first_ball[artefact], self.first_ball[artefact + 1])
        return carry(T, self.artefacts[artefact].centres + moved.ball[:, own])

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        for effect in self.effects:
            points = effect.warp(points, pose, at)
        return points

    def scene(self, at: Moments, moved: Moved, covered: set[int], bump: np.ndarray | None = None, furniture: bool = True) -> Scene:
        """The scene of one moment (P = 1), in the scanner frame."""
        index = int(at.artefact[0])
        if index < 0:
            return Scene(np.zeros((0, 3)), np.zeros(0))
        artefact = self.artefacts[index]
        T = (invert(self.scanner_pose(at, moved)) @ self.artefact_pose(at, moved))[0]
        if bump is not None:
            T = T @ displacement(bump[:3], bump[3:])
        shift = moved.ball[0, self.first_ball[index] : self.first_ball[index + 1]]
        open_ = np.array([b not in covered for b in artefact.balls], dtype=bool)
        centres, radii = carry(T, artefact.centres + shift)[open_], artefact.radii[open_]
        if artefact.triangles is not None:
            return Scene(centres, radii, T_scanner_artefact=T, triangles=artefact.triangles)
        return Scene(centres, radii, artefact.carrier, T) if furniture else Scene(centres, radii)

    def truth(self) -> dict[str, Any]:
        """What the fake cell keeps to itself: errors (n, 5) rad and mm, transforms (4, 4), ball centres by id, effects by name."""
        return {
            "errors": self.deviations.errors,
            "repeatability_rad": self.deviations.repeatability,
            "T_flange_scanner": self.hand_eye,
            "T_base_station": dict(zip(self.facts.station_ids, self.stations, strict=True)),
            "balls": {b: c for a in self.artefacts for b, c in zip(a.balls, a.centres, strict=True)},
            "effects": [{"name": e.name, **e.truth()} for e in self.effects],
        }


def _offset(rng: np.random.Generator, mm: float, rad: float) -> np.ndarray:
    draw = np.clip(rng.standard_normal(6), -2, 2)
    return displacement(mm * draw[:3], rad * draw[3:])
