"""``driver: opcua``: the joint angles of an arm that others move, read by OPC UA. It writes nothing and calls no method."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.devices import (
    ConnectError,
    ContextDevice,
    Cycles,
    Description,
    Fact,
    Field,
    MbcacqError,
    MotionLimits,
    ProtocolError,
    RobotState,
    SafetyStop,
    parse_options,
)
from mbcacq_opcua.link import OpcUaLink
from mbcacq_opcua.nodes import UNITS, text_of
from mbcacq_opcua.options import OpcUaOptions

MOVING_RAD_S = 1e-3  # slower is standing, for ``state().moving`` alone: whether the arm stands at a target the run judges by itself
LONGEST_RAD = 100.0  # no joint turns that far


class OpcUaRobot(ContextDevice):
    """Implements mbcacq.devices.Robot for an arm that is only followed. Options: see OpcUaOptions."""

    plan_facts = ("follow", "controller_joints")
    only_follows = True
    options_model = OpcUaOptions
    first_contact = (
        "The controller's OPC UA server is on, with the companion specification for robots; note its product, version and licence.",
        "`mbcacq doctor {plan} --arm` names maker, model, axes and payload; compare each with the pendant.",
        "The angles agree with the pendant's to its last digit, axis by axis, signs too. If not: axes, angle_unit, controller_joints.",
        "Jog one axis: the angle follows within a second. Note how often it changes; if it comes in steps, note their size.",
    )
    verified_on_hardware = False

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model, self._options = f"robot '{name}'", model, parse_options(OpcUaOptions, f"robot '{name}'", options)
        self._lock = threading.Lock()
        self._link: OpcUaLink | None = None
        self._forget()

    def describe(self) -> Description:
        rate, axes = self._options.rate_hz, (len(self._options.limits_deg),)
        robot = None if self._link is None else self._link.robot
        about = {} if robot is None else robot.about
        settings = {} if self._link is None else dict(self._link.states)
        if robot is not None:
            settings |= {key: value for key, value in about.items() if key in ("Manufacturer", "Model")}
            settings["axes"] = ", ".join(robot.names)
            if robot.payload_kg is not None:
                settings["payload"] = f"{robot.payload_kg:.3g} kg"
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "server's clock since its start (CurrentTime, StartTime)"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer on arrival"),
                Field("q", "rad", axes, rate, "joint angles (ActualPosition)"),
                Field("q_set", "rad", axes, rate, "NaN: no set point is served"),
                Field("q_command", "rad", axes, rate, "NaN: nothing is commanded"),
            ),
            serial=about.get("SerialNumber", ""),
            firmware=about.get("Software", ""),
            settings=settings,
        )

    def facts(self) -> tuple[Fact, ...]:
        """The last reading gives them."""
        found = {} if self._link is None else dict(self._link.facts)
        mass = found.pop("payload", None)
        load = () if not isinstance(mass, int | float) else (Fact("payload", float(mass), "kg", self._options.payload_tolerance_kg),)
        return (*load, *(Fact(name, text_of(value)) for name, value in found.items()))

    def connect(self) -> None:
        """Connect, find the robot's nodes, read them once. Raises ConnectError, IdentityError, ConfigError, ProtocolError, DeviceFault."""
        self.close()
        self._forget()
        link = self._link = OpcUaLink(self._name, self._options, self._take, self._fail)
        try:
            link.connect()
        except BaseException:
            self.close()
            raise
        if (error := self._error) is not None or self._latest is None:
            self.close()
            raise error or ConnectError(f"{self._name}: the connection was closed while it was made; connect again")

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Raises SafetyStop: this driver moves nothing."""
        raise SafetyStop(f"{self._name} is only read by OPC UA, others move it; nothing was moved")

    def state(self) -> RobotState:
        with self._lock:
            if self._error is not None:
                raise self._error.with_traceback(None)
            if self._link is None or self._latest is None:
                raise ConnectError(f"{self._name} is not connected; connect it first")
            time_s, q = self._latest
            return RobotState(time_s, q.copy(), self._moving, False)

    def cycles(self) -> Cycles:
        with self._lock:
            rows, self._rows = self._rows, []
        if not rows:
            return Cycles({})
        time_s, host, q = (np.array(column) for column in zip(*rows, strict=True))
        unknown = np.full_like(q, np.nan)
        return Cycles({"time_s": time_s, "host_time_s": host, "q": q, "q_set": unknown, "q_command": unknown})

    def stop(self) -> None:
        """The arm is not ours to stop: nothing is sent."""

    def close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _forget(self) -> None:
        self._latest: tuple[float, np.ndarray] | None = None
        self._error: MbcacqError | None = None
        self._moving = False
        self._rows: list[tuple[float, float, np.ndarray]] = []

    def _take(self, time_s: float, angles: list[float]) -> None:
        """A reading (in the link's thread). Raises ProtocolError for angles that cannot be."""
        q = self._as_in_the_plan(np.array(angles))
        if not np.isfinite(q).all() or np.abs(q).max() > LONGEST_RAD:
            raise ProtocolError(f"{self._name}: joint angles that cannot be; is angle_unit right?")
        with self._lock:
            if self._latest is not None and time_s > self._latest[0]:
                self._moving = bool(np.abs(q - self._latest[1]).max() > MOVING_RAD_S * (time_s - self._latest[0]))
            self._latest = time_s, q
            self._rows.append((time_s, time.monotonic(), q))

    def _as_in_the_plan(self, angles: np.ndarray) -> np.ndarray:
        """q (n,) rad as the robot file counts it, of angles as the server gives them."""
        o, robot = self._options, None if self._link is None else self._link.robot
        stated = ("",) * len(angles) if robot is None else robot.units
        deg = np.array(
            [
                np.degrees(a) if (unit if unit in UNITS.values() else o.angle_unit) == "rad" else a
                for a, unit in zip(angles, stated, strict=True)
            ]
        )
        if o.controller_offset_deg is not None:
            deg = deg - np.array(o.controller_offset_deg)
        return np.radians(deg if o.controller_matrix is None else np.linalg.solve(np.array(o.controller_matrix), deg))

    def _fail(self, error: MbcacqError) -> None:
        with self._lock:
            self._error = error
