"""An arm that is only followed: the run waits until it stands near a target, and takes what is there. Nothing is commanded."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.mover import MOVED
from mbcacq.devices import DeviceTimeout, MotionLimits, Robot, RobotState
from mbcacq.plan.schema import FollowUse
from mbcacq.quantities import from_degrees, in_degrees

POLL_S = 0.02
REMIND_S = 20.0  # between two sentences on how far the arm still is


class Follower:
    """Waits for an arm that a person, or its own program, moves; takes the place of ``Mover``, and has its members.

    still: rad, or (n,) in the units of the axes; a joint that moves by more does not stand. lead: of a fake arm, brings it near a
    target in a person's place.
    """

    def __init__(
        self,
        robot: Robot,
        limits: MotionLimits,
        collector: CycleCollector,
        follow: FollowUse,
        still: float | np.ndarray,
        bus: EventBus,
        lead: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        self._robot, self.limits, self._collector, self._follow, self._still = robot, limits, collector, follow, still
        self._bus, self._lead = bus, lead
        self._turned: np.ndarray | None = None  # (n,) rad, the furthest that each axis has come since it last turned round
        self.direction = np.zeros(len(limits.speed), dtype=int)
        self.farthest = 0.0  # rad, of the poses that were taken, from their targets

    def summary(self) -> str:
        """How far the arm stood from its targets, as a clause."""
        return f", taken up to {in_degrees(self.farthest):.2f}° from their targets"

    def pass_by(self, waypoint: np.ndarray) -> None:
        """Which way the arm takes is up to whoever moves it."""

    def go(self, target: np.ndarray) -> RobotState:
        """Wait until the arm stands near ``target`` (n,) rad. Raises DeviceTimeout if it does not in time, and as the driver."""
        self._bus.state("waiting")  # the sentence stands on the terminal instead of the bar
        self._say(f"bring the arm to {_angles(target)}")
        if self._lead is not None:
            self._lead(target)
        began = reminded = time.monotonic()
        while True:
            self._collector.check()
            state, stood_s = self._look()
            away = np.abs(state.q - target)
            near = bool(np.max(away) <= from_degrees(self._follow.tolerance_deg))
            if near and stood_s >= self._follow.stand_s:
                self.farthest = max(self.farthest, float(np.max(away)))
                self._say(f"the arm stands {_farthest(away)} from its target")
                return state
            now = time.monotonic()
            if now - began > self._follow.timeout_s:
                what = "does not stand still near it" if near else f"is {_farthest(away)} from it"
                raise DeviceTimeout(
                    f"the arm was not brought to its target {_angles(target)} within {self._follow.timeout_s:g} s and {what}; "
                    "bring it there and resume the run, or allow more (robot: follow: tolerance_deg, timeout_s)"
                )
            if now - reminded > REMIND_S:
                reminded = now
                self._say("the arm moves" if near else f"the arm is {_farthest(away)} from its target")
            time.sleep(POLL_S)

    def _look(self) -> tuple[RobotState, float]:
        """The latest state, and how long the arm has been standing by the robot's clock."""
        state = self._robot.state()
        if self._turned is None:
            self._turned, self._rest, self._rest_since = state.q.copy(), state.q, state.time_s
        step = state.q - self._turned
        onward = (np.sign(step) == self.direction) | (np.abs(step) > MOVED)
        self.direction = np.where(np.abs(step) > MOVED, np.sign(step), self.direction).astype(int)
        self._turned = np.where(onward, state.q, self._turned)
        if np.any(np.abs(state.q - self._rest) > self._still):
            self._rest, self._rest_since = state.q, state.time_s
        return state, state.time_s - self._rest_since

    def _say(self, text: str) -> None:
        self._bus.emit(events.Message, "info", text, events.OPERATOR)


def _angles(q: np.ndarray) -> str:
    return " ".join(f"A{k} {angle:.2f}°" for k, angle in enumerate(in_degrees(q), 1))


def _farthest(away: np.ndarray) -> str:
    """The largest of the distances (n,) rad, with its axis."""
    axis = int(np.argmax(away))
    return f"{in_degrees(away[axis]):.2f}° (A{axis + 1})"
