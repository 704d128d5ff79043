"""A simulated arm of any number of axes behind the plain interface of a robot driver: what a dry run takes where a driver has no fake.

It has no wire: it lives in the process of the run and publishes where it is to the fake cell. Its clock advances while it moves or settles,
when it is asked for its state, so that a run goes as fast as it asks; and by what other devices take. At rest it stands: how often a run
looks after an arm that waits depends on the computer, and nothing measured may. A real run cannot use it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError, ContextDevice, Cycles, Description, Field, MotionLimits, RobotState, SafetyStop, joint_target
from mbcacq_fakes.dynamics.timed_arm import TimedArm

CYCLE_S = 0.004
CYCLES_AT_ONCE = 25  # of a motion, per look at the state
LED = (1.0, 5.0, 50.0)  # rad/s, rad/s^2, rad/s^3 of an arm that a person moves
BRAKING_S = 0.1  # from the largest speed to rest


class LedTarget:
    """Where a person brings a simulated arm that is only followed; from any thread."""

    def __init__(self) -> None:
        self._target: np.ndarray | None = None

    def lead(self, target: np.ndarray) -> None:
        self._target = np.array(target, dtype=float)

    def take(self) -> np.ndarray | None:
        """The target (n,) rad, once."""
        target, self._target = self._target, None
        return target

    def stop(self) -> None:
        """A simulated robot is its own controller: there is none to stop."""


class SimulatedRobot(ContextDevice):
    """Implements mbcacq.devices.Robot. options: limits_deg (n, 2) and, from the fake cell, state, clock_start_s and clock, which says how
    long other devices took; led, a LedTarget; follow: it moves by that alone. Others are of the plan's own driver."""

    plan_facts = ("follow",)

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model = name, model
        self._limits = np.radians(np.array(options.get("limits_deg", ()), dtype=float).reshape(-1, 2))
        self._state, self._clock_start = options.get("state"), float(options.get("clock_start_s", 0.0))
        self._clock = options.get("clock")
        self._led, self._follow = options.get("led"), bool(options.get("follow"))
        self._lock = threading.RLock()
        self._connected = False

    def describe(self) -> Description:
        axes, rate = (len(self._limits),), 1.0 / CYCLE_S
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "simulated clock"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer"),
                Field("q", "rad", axes, rate, "joint angles"),
                Field("q_set", "rad", axes, rate, "set point"),
                Field("q_command", "rad", axes, rate, "target of the motion under way"),
            ),
            serial="simulated",
        )

    def connect(self) -> None:
        """Raises ConfigError outside a dry run."""
        if self._state is None:
            raise ConfigError("the simulated robot is there in a dry run only; run the plan with --dry-run, or name your arm's driver")
        with self._lock:
            reading = self._state.read()
            self._arm = TimedArm(np.array(reading.q), self._state, self._clock_start, reading.arrivals)
            self._wanted, self._under_way, self._rows = None, False, []
            self._connected = True

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a jerk-limited motion to q (n,) rad. Raises SafetyStop for a target outside the limits, ConfigError for wrong limits."""
        if self._follow:
            raise SafetyStop(f"robot '{self._name}' is only followed (robot: follow); nothing was moved")
        with self._lock:
            self._check()
            target = joint_target(f"robot '{self._name}'", q, self._limits)
            bounds = [np.broadcast_to(np.asarray(v, dtype=float), target.shape) for v in (limits.speed, limits.acceleration, limits.jerk)]
            if not all(np.isfinite(b).all() and (b > 0).all() for b in bounds):
                raise ConfigError(f"robot '{self._name}': speed, acceleration and jerk limits must be positive")
            self._begin(target, bounds)
            self._wanted, self._under_way = limits, True

    def state(self) -> RobotState:
        """The state, a little later than at the last call where it is under way. Raises ConfigError before ``connect``."""
        with self._lock:
            self._check()
            if self._led is not None and (target := self._led.take()) is not None:
                self._begin(target, [np.full(len(target), v) for v in LED])
            waited = 0.0 if self._clock is None else self._clock.take()
            under_way = self._arm.moving or self._under_way or self._follow
            for _ in range(round(waited / CYCLE_S) + (CYCLES_AT_ONCE if under_way else 0)):
                self._step()
            wanted, arm = self._wanted, self._arm
            arrived = (
                wanted is not None
                and not arm.moving
                and bool(np.all(np.abs(arm.q - arm.target) <= wanted.tolerance))
                and arm.still_s >= wanted.settle_s - 1e-9
            )
            self._under_way = self._under_way and not arrived
            return RobotState(arm.time_s, arm.q.copy(), arm.moving, arrived)

    def cycles(self) -> Cycles:
        with self._lock:
            rows, self._rows = getattr(self, "_rows", []), []
        if not rows:
            return Cycles({})
        names = ("time_s", "host_time_s", "q", "q_set", "q_command")
        return Cycles({name: np.array([row[k] for row in rows]) for k, name in enumerate(names)})

    def stop(self) -> None:
        """Brakes; the arm stands when this returns."""
        with self._lock:
            if not self._connected:
                return
            self._wanted, self._under_way = None, False
            if self._arm.moving:
                fastest = np.maximum(np.abs(self._arm.qd), np.radians(1.0))
                self._arm.brake(fastest / BRAKING_S, fastest / BRAKING_S / CYCLE_S)
            while self._arm.moving:
                self._step()

    def close(self) -> None:
        self.stop()
        with self._lock:
            self._connected = False

    def _check(self) -> None:
        if not self._connected:
            raise ConfigError(f"robot '{self._name}' is not connected; connect it first")

    def _begin(self, target: np.ndarray, bounds: list[np.ndarray]) -> None:
        try:
            self._arm.go(target, *bounds)
        except ValueError:
            raise ConfigError(f"robot '{self._name}': this motion cannot be timed; set the plan's robot: speed higher") from None

    def _step(self) -> None:
        """One cycle later."""
        self._arm.advance(CYCLE_S)
        self._rows.append((self._arm.time_s, time.monotonic(), self._arm.q, self._arm.q, self._arm.target))
