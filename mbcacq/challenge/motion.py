"""Challenges in motion: faults drawn and concealed in a moving arm, its recordings diagnosed unseen, the envelope opened and scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mbcacq.challenge.motion_score import judge
from mbcacq.diagnosis.motion import base_alone, diagnose_trajectories
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory

CATALOGUE = (
    "channel_latency",
    "drive_lag",
    "friction",
    "joint_compliance",
    "backlash",
    "gear_transmission_error",
    "torque_ripple",
    "joint_scale",
    "wrist_coupling",
    "payload",
    "gravity_compensator",
)
CLEAN, ONE, TWO = 0.15, 0.65, 0.85  # shares of challenges with nothing, at most one, at most two faults; the others have three
MOTIONS = 2

Record = Callable[..., Any]


@dataclass(frozen=True)
class MotionChallenge:
    """number: its seed. faults: as the fake arm is told. seconds: of each motion; liveliness: share of the speed limits."""

    number: int
    faults: tuple[dict[str, Any], ...]
    seconds: float
    liveliness: float


@dataclass(frozen=True)
class MotionResult:
    challenge: MotionChallenge
    truth: list[dict[str, Any]]
    matters: list[bool]
    verdict: str
    told: list[str]
    named: bool
    extra: list[str]
    sigmas: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def draw(number: int) -> MotionChallenge:
    """The envelope of a number, always the same."""
    rng = np.random.default_rng([number, 4711])
    kind = rng.uniform()
    many = 0 if kind < CLEAN else 1 if kind < ONE else 2 if kind < TWO else 3
    names = rng.choice(CATALOGUE, many, replace=False)
    faults = tuple({"name": str(name), "strength": float(rng.uniform(0.5, 2.0))} for name in names)
    return MotionChallenge(number, faults, float(rng.choice([10.0, 12.0, 16.0])), float(rng.uniform(0.3, 0.7)))


def take(challenge: MotionChallenge, robot: RobotModel, record: Record) -> MotionResult:
    """record: the fake arm's recorder (``mbcacq_fakes.dynamics.recorded.recorded``)."""
    trajectories, truth = recordings(challenge, robot, record, challenge.faults)
    diagnosis = diagnose_trajectories(trajectories, proof=False)
    before = base_alone(trajectories)
    matters = []
    for i in range(len(challenge.faults)):
        # The same arm, the same dice: only this fault is absent.
        muted = tuple({**f, "strength": 1e-9} if k == i else f for k, f in enumerate(challenge.faults))
        without = base_alone(recordings(challenge, robot, record, muted)[0])
        matters.append(any(bool((without[kind] < 0.9 * before[kind]).any()) for kind in before))
    named, extra, told, sigmas = judge(truth, matters, diagnosis)
    return MotionResult(challenge, truth, matters, diagnosis["verdict"], told, named, extra, sigmas)


def recordings(
    challenge: MotionChallenge, robot: RobotModel, record: Record, faults: Sequence[dict[str, Any]]
) -> tuple[list[Trajectory], list[dict[str, Any]]]:
    made = [record(robot, faults, challenge.number, motion, challenge.seconds, challenge.liveliness) for motion in range(MOTIONS)]
    return [
        Trajectory(robot, r.time_s, r.q, q_set=r.q_set, q_joint=r.q_joint, torque=r.torque, name=f"{challenge.number}-{k}")
        for k, r in enumerate(made)
    ], made[0].truth
