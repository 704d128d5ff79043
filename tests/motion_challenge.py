"""Challenges in motion: effects drawn and injected into a moving arm, its recordings diagnosed without knowing them, and scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.diagnose import Recordings, diagnose_trajectories
from mbcacq.diagnosis.motion.effect_selection import EffectSelection
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.effects.catalogue import declaration, effects
from mbcacq.effects.effect import Parameters
from mbcacq.effects.support import with_drives_for
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory

NONE, ONE, TWO = 0.15, 0.65, 0.85  # cumulated shares of challenges with no, one and two effects; the others have three
MOTIONS = 2
ABSENT = 1e-9  # strength of an effect that is switched off while the random numbers of all others stay
DETECTABLE = 0.9  # an effect counts if without it the held-out mean square of a joint falls below this share

Truth = Mapping[str, Any]
Location = tuple[str, tuple[str, ...]]
Record = Callable[..., Any]
PERIOD = {"phase_deg": 360.0}  # of a parameter that is an angle of a periodic component
SAME_ORDER = 0.5  # periods per turn within which two periodic components are the same


def catalogued_in_motion() -> tuple[str, ...]:
    """The effects of the catalogue that are injected into motion, by the numbers that they declare."""
    numbers = {name: challenge.in_motion or 0 for name in effects() if (challenge := declaration(name).challenge) is not None}
    return tuple(sorted((name for name, number in numbers.items() if number), key=lambda name: numbers[name]))


@dataclass(frozen=True)
class MotionChallenge:
    """number: its seed. effects: as the fake arm takes them. seconds: of each motion; liveliness: share of the speed limits."""

    number: int
    effects: tuple[dict[str, Any], ...]
    seconds: float
    liveliness: float


@dataclass(frozen=True)
class MotionScore:
    """identified: every effect that is detectable is reported, with name and location, before any that was not injected. false_names:
    effects reported that were not injected; reported: all. sigmas: errors of parameters in stated standard deviations."""

    identified: bool
    false_names: list[str]
    reported: list[str]
    sigmas: dict[str, float]


@dataclass(frozen=True)
class MotionChallengeResult:
    """truth: the injected effects; detectable: which of them change a mismatch enough to be found."""

    challenge: MotionChallenge
    truth: list[dict[str, Any]]
    detectable: list[bool]
    verdict: str
    score: MotionScore

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def draw(number: int) -> MotionChallenge:
    """The challenge of a number, always the same."""
    rng = np.random.default_rng([number, 4711])
    kind = rng.uniform()
    many = 0 if kind < NONE else 1 if kind < ONE else 2 if kind < TWO else 3
    names = rng.choice(catalogued_in_motion(), many, replace=False)
    effects = tuple({"name": str(name), "strength": float(rng.uniform(0.5, 2.0))} for name in names)
    return MotionChallenge(number, effects, float(rng.choice([10.0, 12.0, 16.0])), float(rng.uniform(0.3, 0.7)))


def run_challenge(challenge: MotionChallenge, robot: RobotModel, record: Record) -> MotionChallengeResult:
    """Record, diagnose, score. record: the fake arm's recorder (``mbcacq_fakes.dynamics.recorded.recorded``)."""
    trajectories, truth = recordings(challenge, robot, record, challenge.effects)
    diagnosis = diagnose_trajectories(trajectories, cross_validation=False)
    before = base_alone(trajectories)
    detectable = []
    for i in range(len(challenge.effects)):
        others = tuple({**e, "strength": ABSENT} if k == i else e for k, e in enumerate(challenge.effects))
        without = base_alone(recordings(challenge, robot, record, others)[0])
        detectable.append(any(bool((without[kind] < DETECTABLE * before[kind]).any()) for kind in before))
    return MotionChallengeResult(challenge, truth, detectable, diagnosis.verdict, score_motion(truth, detectable, diagnosis))


def base_alone(trajectories: Sequence[Trajectory]) -> dict[str, np.ndarray]:
    """Chi2 per degree of freedom (J,) by kind of mismatch, held out, of offsets and the arm's inertial parameters: no effect is tried."""
    known = Recordings(trajectories)
    out = {}
    for group in channel_groups(known.runs, known.inertial, known.robot):
        selection = EffectSelection(MotionModel(group, known.runs), candidates=[])
        out[group.name] = selection.start / selection.model.floor**2
    return out


def recordings(
    challenge: MotionChallenge, robot: RobotModel, record: Record, effects: Sequence[dict[str, Any]]
) -> tuple[list[Trajectory], list[dict[str, Any]]]:
    """The motions of a challenge with these effects, and the truth about them."""
    runs = [record(robot, effects, challenge.number, motion, challenge.seconds, challenge.liveliness) for motion in range(MOTIONS)]
    for one in runs[0].truth:  # an arm is made with what it has
        robot = with_drives_for(robot, one["name"], tuple(one["where"]))
    trajectories = [
        Trajectory(robot, r.time_s, r.q, q_set=r.q_set, q_joint=r.q_joint, torque=r.torque, name=f"{challenge.number}-{k}")
        for k, r in enumerate(runs)
    ]
    return trajectories, runs[0].truth


def score_motion(truth: Sequence[Truth], detectable: Sequence[bool], diagnosis: MotionDiagnosis) -> MotionScore:
    """truth: the injected effects, each with name, where and parameters; detectable: which of them must be found."""
    injected = {_location(t) for t in truth}
    required = {_location(t) for t, needed in zip(truth, detectable, strict=True) if needed}
    reported = {(e.name, e.where): e.parameters for e in diagnosis.named_effects}
    first: list[Location] = []
    for location in reported:
        if location not in injected:
            break
        first.append(location)
    sigmas: dict[str, float] = {}
    for t in truth:
        if _location(t) in reported:
            errors = _errors(t["parameters"], reported[_location(t)])
            sigmas |= {f"{t['name']}:{key}": value for key, value in errors.items()}
    false_names = [_text(location) for location in reported if location not in injected]
    return MotionScore(required <= set(first), false_names, [_text(location) for location in reported], sigmas)


def _location(truth: Truth) -> Location:
    return truth["name"], tuple(truth["where"])


def _text(location: Location) -> str:
    return f"{location[0]}:{'+'.join(location[1])}"


def _errors(truth: Mapping[str, Any], found: Parameters) -> dict[str, float]:
    """Largest error among the components of each parameter; that of the nearest order counts among several periodic components."""
    component = _nearest_order(truth, found)
    if component is not None and component < 0:
        return {}
    out = {}
    for key in [k for k in truth if k in found]:
        value, std = (np.array(each) for each in found[key].components)
        if component is not None:
            value, std = value[[component]], std[[component]]
        error = value - np.atleast_1d(truth[key])
        period = PERIOD.get(key.rpartition(".")[2])
        if period is not None:
            error = (error + period / 2) % period - period / 2
        if (std > 0).all():
            out[key] = float(np.max(np.abs(error) / std))
    return out


def _nearest_order(truth: Mapping[str, Any], found: Parameters) -> int | None:
    """Which of several periodic components is meant, -1 if none is near; None for an effect without an order."""
    key = next((k for k in truth if k.endswith(".order")), None)
    if key is None or key not in found:
        return None
    distances = np.abs(np.array(found[key].components[0]) - truth[key])
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] <= SAME_ORDER else -1
