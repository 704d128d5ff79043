"""KUKA robots over EthernetKRL, for mbcacq: PTP moves by a program on the controller, its state as a stream."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mbcacq.devices import (
    ConfigError,
    ConnectError,
    ContextDevice,
    Cycles,
    Description,
    DeviceFault,
    Fact,
    Field,
    MotionLimits,
    RobotState,
    SafetyStop,
    joint_target,
    parse_options,
)
from mbcacq_kuka.controller_files import eki_files
from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.cell_check import check_cell
from mbcacq_kuka.eki.options import EkiOptions
from mbcacq_kuka.eki.record import Record
from mbcacq_kuka.eki.session import EkiSession
from mbcacq_kuka.eki.telegrams import PTP, State
from mbcacq_kuka.eki.watch import Move
from mbcacq_kuka.option_values import check_output

_STANDSTILL_S = 5.0
_ROUNDING = 1e-6  # deg or mm


class KukaEki(ContextDevice):
    """A six-axis KUKA arm behind EthernetKRL, and the external axes that its controller moves with it. ``options``: see
    options.EkiOptions. Implements mbcacq.devices.Robot.

    A move is done when the arm stands at its target, not when the controller says so. A lost connection brakes the arm: the
    controller does that by itself. It is taken up again only if the arm stood still when it was lost.
    """

    plan_facts = ("kinematics", "follow", "external_axes")

    options_model = EkiOptions
    first_contact = (
        "`mbcacq controller-files {plan} --out files`; programs and channel are on the controller, the link program in its submit "
        "interpreter.",
        "`mbcacq doctor {plan} --arm` names model, machine data, tool and load; compare each with the smartPAD. Note KSS and EKI versions.",
        "The angles in the viewer agree with the smartPAD's axis display to 0.001°, A1 to A6, signs too.",
        "Only if the plan has external axes: jogged by hand, each goes the way that the plan's direction says, in mm or degrees.",
        "In T1 start mbcacq_eki: doctor says that the program is ready; its first move waits for the start key.",
        "Stop the program on the smartPAD: the run ends with the sentence that the program was stopped.",
        "Only if the plan names digital_outputs: the smartPAD's outputs show each on for the pulse of an exposure, then off; "
        "stop a run in a pulse: it goes off.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model = name, model
        self._options = parse_options(EkiOptions, f"robot '{name}'", options)
        self._session: EkiSession | None = None
        self._record = Record(self._options)
        self._lock = threading.Lock()
        self._number = self._stopped = 0

    @staticmethod
    def controller_files(name: str, model: str, options: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
        """Path -> text of everything that goes onto the controller, for this plan. See controller_files.eki_files."""
        return eki_files(parse_options(EkiOptions, f"robot '{name}'", options), facts)

    def describe(self) -> Description:
        rate, axes = 1000.0 / self._options.state_ms, (len(self._options.axes),)
        hello = None if self._session is None else self._session.hello
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "robot clock ($ROB_TIMER)"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer on arrival"),
                Field("q", "rad", axes, rate, "measured axis angles ($AXIS_ACT_MEAS)"),
                Field("q_command", "rad", axes, rate, "target of the move under way"),
                Field("current_percent", "%", (6,), rate, "motor currents ($CURR_ACT)"),
                Field("tool_in_base_mm_deg", "mm, deg", (6,), rate, "X, Y, Z, A, B, C of the tool in the base ($POS_ACT)"),
                Field("override_percent", "%", (), rate, "program override ($OV_PRO)"),
                Field("sign_of_life_ms", "ms", (), rate, "age of our last sign of life, on the robot's clock"),
                Field("connection", "1", (), rate, "how many connections this one is; a step is a gap in the stream"),
            ),
            serial="" if hello is None else hello.model,
            firmware="" if hello is None else hello.machine_data,
            verified_on_hardware=False,
        )

    def facts(self) -> tuple[Fact, ...]:
        """Tool, base and operating mode end the run by themselves."""
        session = self._session
        if session is None or (state := session.state) is None:
            return ()
        load = () if state.load_kg < 0 else (Fact("load", state.load_kg, "kg", 0.05),)
        return (*load, Fact("override", float(state.override), "%", 0.5, critical=False))

    def connect(self) -> None:
        """Connect, wait for the controller's program, compare its cell with the plan. Raises ConnectError, IdentityError, DeviceFault."""
        self.close()
        self._record = Record(self._options)
        session = self._session = EkiSession(
            self._name, self._options, self._record, lambda hello, state: check_cell(self._name, self._model, self._options, hello, state)
        )
        try:
            session.open()
        except BaseException:
            self.close()
            raise
        first = session.latest
        self._number = self._stopped = max(first.last, first.refused, first.cancelled)

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a PTP motion to q (n,) rad or mm, external axes first. Raises SafetyStop for a target outside the
        limits, and any fault met so far.

        Speed is a percentage of the controller's axis speeds, rounded down for the slowest axis; acceleration is option
        acceleration_percent, the jerk the controller's own. A move under way is stopped first.
        """
        self._refuse_following()
        session = self._check()
        o, robot = self._options, f"robot '{self._name}'"
        external = np.asarray(q, dtype=float)[: len(o.external_axes)]
        arm = joint_target(robot, np.asarray(q)[len(external) :], np.radians(o.limits_deg))
        target = o.in_telegram(np.concatenate([external, arm]))
        for name, value, (low, high) in list(zip(o.axes, target, o.limits, strict=True))[len(arm) :]:
            if not low - _ROUNDING <= value <= high + _ROUNDING:
                raise SafetyStop(f"{robot}: {name} would go to {value:.3f}, outside the plan's limits {low:g}..{high:g}; nothing was moved")
        speed = o.in_telegram(np.broadcast_to(np.asarray(limits.speed, dtype=float), target.shape))
        if not (np.isfinite(speed).all() and (speed > 0).all()):
            raise ConfigError(f"{robot}: speed limits must be positive")
        percent = float(np.floor(np.clip(100.0 * np.min(speed / o.speeds) + 1e-9, 1.0, 100.0)))
        wanted = np.clip(target, *o.limits.T)
        tolerance = o.in_telegram(np.broadcast_to(np.asarray(limits.tolerance, dtype=float), target.shape))

        def away(state: State) -> float:
            return float(np.max(np.abs(np.array(state.axis) - wanted) / tolerance))

        self._begin(session, PTP, away, limits.settle_s, wanted, speed=percent, axes=wanted.tolist())

    def set_output(self, number: int, value: bool) -> None:
        """Switch $OUT[number], one of the option digital_outputs; returns once the controller says that it did. It is switched off by
        ``stop``, and by the controller itself where it loses the connection or stops the arm.

        Raises ConfigError, DeviceTimeout (no answer), DeviceFault (not switched), and what stopped the arm."""
        check_output(self._name, number, self._options.digital_outputs)
        self._check().switch(number, bool(value))

    @property
    def digital_outputs(self) -> tuple[int, ...]:
        """Numbers of the outputs that may be switched."""
        return self._options.digital_outputs

    def state(self) -> RobotState:
        session = self._check()
        state, arrived = session.latest, session.arrived
        moving = bool(state.moving) or (session.busy and not arrived)
        return RobotState(state.time * 1e-3, self._options.in_plan(state.axis), moving, arrived)

    def cycles(self) -> Cycles:
        return self._record.drain()

    def stop(self) -> None:
        """The controller brakes the move under way on its path, forgets those that wait, and switches the outputs off; no connection, no
        motion either."""
        session = self._session
        if session is None:
            return
        with self._lock:
            due = self._number > self._stopped or session.switched_on
            number, self._stopped = (self._number if due else None), self._number
        if number is not None:
            session.halt(number)

    def close(self) -> None:
        self.stop()
        session, self._session = self._session, None
        if session is not None:
            session.close(_STANDSTILL_S)

    def _begin(
        self, session: EkiSession, kind: int, away: Callable[[State], float], settle_s: float, target: np.ndarray | None, **values: Any
    ) -> None:
        if session.busy and not session.arrived:
            self.stop()
        session.await_link()
        with self._lock:
            number = self._number = self._number + 1
        session.begin(
            Move(number, away, settle_s),
            None if target is None else tuple(target.tolist()),
            telegrams.command(
                kind, number, session.beat, acceleration=self._options.acceleration_percent, names=self._options.axes, **values
            ),
        )

    def _refuse_following(self) -> None:
        if self._options.follow:
            raise SafetyStop(f"robot '{self._name}' is only followed (robot: follow); nothing was moved")

    def _check(self) -> EkiSession:
        """Raise what has stopped the arm."""
        session = self._session
        if session is None:
            raise ConnectError(f"robot '{self._name}' is not connected; call connect first")
        if session.error is None and self._record.lost:
            session.fail(
                DeviceFault(
                    f"robot '{self._name}': {self._record.lost} states were lost because they were not fetched in time; the arm is stopped"
                )
            )
        if session.error is not None:
            self.stop()
            raise session.error.with_traceback(None)
        return session
