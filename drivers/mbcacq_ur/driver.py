"""``driver: ur_rtde``: Universal Robots arms. The program ``mbcacq_ur.script`` (``mbcacq controller-files``) must run on the controller."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.devices import (
    ConfigError,
    ConnectError,
    ContextDevice,
    Cycles,
    Description,
    DeviceFault,
    DeviceTimeout,
    Fact,
    Field,
    MbcacqError,
    MotionLimits,
    ProtocolError,
    RobotState,
    SafetyStop,
    joint_target,
    parse_options,
)
from mbcacq_ur.link import RtdeLink, Values
from mbcacq_ur.options import AXES, UrOptions
from mbcacq_ur.safety import PLAYING, not_ready, safety_stop

PROGRAM = 20261  # which mbcacq_ur.script this driver works with
MOVE, STOP = 1, 2
LEAST_TRAVEL = 1e-6  # rad; below it an axis stands
LAST_NUMBER = 2**30  # of commands, then they begin again
IDLE_S = 0.5  # on the controller's clock: idle for longer, and not at the target, the move was ended by something else
WATCHDOG_S = 0.2  # without a package from here, as mbcacq_ur.script asks of the controller
COLUMNS = {"q": "actual_q", "q_set": "target_q", "current_A": "actual_current", "joint_temperature_C": "joint_temperatures"}


class UrRtdeRobot(ContextDevice):
    """Implements mbcacq.devices.Robot. Options: see UrOptions. Losing the connection stops the arm: its program has a watchdog.

    Under the option follow it only listens: it needs no program on the controller, and it never moves the arm.
    """

    plan_facts = ("follow",)
    options_model = UrOptions
    first_contact = (
        "RTDE is enabled (Settings, Security, Services); `ping` answers in under 1 ms. Note the software version.",
        "`mbcacq controller-files {plan} --out files`; mbcacq_ur.script is loaded in a Script node and plays, in reduced mode at first.",
        "`mbcacq doctor {plan} --arm` names software, speed slider, payload and safety; compare each with the pendant.",
        "The angles in the viewer agree with the pendant's Move screen to 0.01°, base to wrist 3, signs too.",
        "Push against the arm until it stops protectively: the run ends with the sentence 'is protective stopped'.",
        "Stop the program on the pendant: the run ends with the sentence that its program was stopped.",
    )
    verified_on_hardware = False

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model, self._options = f"robot '{name}'", model, parse_options(UrOptions, f"robot '{name}'", options)
        self._limits = np.radians(self._options.limits_deg)
        self._changed = threading.Condition()
        self._link: RtdeLink | None = None
        self._forget()

    @staticmethod
    def controller_files(name: str, model: str, options: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
        """mbcacq_ur.script with the plan's payload, and what to do with it."""
        script = (Path(__file__).parent / "controller" / "mbcacq_ur.script").read_text(encoding="ascii")
        mass, centre = float(facts["load_kg"]), [v / 1000 for v in facts["load_centre_mm"]]
        payload = (
            f"set_payload({mass:.3f}, [{centre[0]:.4f}, {centre[1]:.4f}, {centre[2]:.4f}])" if mass > 0 else "# no payload in the plan"
        )
        script = script.replace("@PROGRAM@", str(PROGRAM)).replace("@PAYLOAD@", payload)
        readme = (
            f"Files for {model or 'a UR arm'} and the plan '{facts['plan']}'. Nobody has tried them on hardware.\n\n"
            "1. Enable RTDE (Settings, Security, Services). Remote control is not needed.\n"
            "2. Copy mbcacq_ur.script to a USB stick; in a new program take a Script node, type File, and load it.\n"
            "3. Speed slider to 100 %: the plan's speeds are what is driven. Reduced mode for a first run.\n"
            "4. Press play, then on this computer: mbcacq run PLAN --arm --step\n"
        )
        return {"mbcacq_ur.script": script, "README.txt": "".join(c if c.isascii() else "?" for c in readme)}

    def describe(self) -> Description:
        rate, axes = self._options.frequency_hz, (AXES,)
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "controller's clock (timestamp)"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer on arrival"),
                Field("q", "rad", axes, rate, "measured joint angles (actual_q)"),
                Field("q_set", "rad", axes, rate, "set point (target_q)"),
                Field("q_command", "rad", axes, rate, "target of the motion under way"),
                Field("current_A", "A", axes, rate, "joint currents (actual_current)"),
                Field("joint_temperature_C", "deg C", axes, rate, "of the joints (joint_temperatures)"),
            ),
            firmware=self._link.version if self._link is not None else "",
            settings={fact.name: fact.text for fact in self.facts()},
        )

    def facts(self) -> tuple[Fact, ...]:
        """The last package gives them."""
        if (latest := self._latest) is None:
            return ()
        return (
            Fact("speed slider", 100.0 * latest["target_speed_fraction"], "%", 0.5, critical=False),
            Fact("payload", latest["payload"], "kg", self._options.payload_tolerance_kg),
            Fact("payload centre", ", ".join(f"{1e3 * v + 0.0:.1f}" for v in latest["payload_cog"]), "mm"),
            Fact("safety", "reduced" if latest["safety_status_bits"] >> 1 & 1 else "normal", critical=False),
        )

    def connect(self) -> None:
        """Connect, agree on what is exchanged, and wait until the controller is ready and runs our program.

        Raises ConnectError (also for a controller that stays stopped), ProtocolError, ConfigError for another payload than the plan's.
        """
        self.close()
        self._forget()
        self._link = RtdeLink(self._name, self._options, self._take, self._fail)
        self._link.connect()
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or self._why() == "", self._options.connect_timeout_s)
            error, why, latest = self._error, self._why(), self._latest
            if latest is not None:
                self._number = int(latest["output_int_register_0"])
        if error is None and why == "":
            try:
                self._check_payload()
            except ConfigError:
                self.close()
                raise
            return
        self.close()
        place = f"{self._options.address}:{self._options.port}"
        raise ConnectError(f"{self._name} at {place}: {error}" if error is not None else f"{self._name} at {place} {why}") from error

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a movej to q (6,) rad, as fast as keeps every axis within its limits. Raises SafetyStop outside the limits."""
        target = joint_target(self._name, q, self._limits)
        with self._changed:
            self._check()
            latest = self._latest
        assert latest is not None, "a connected robot has a state"
        travel = np.maximum(np.abs(target - latest["actual_q"]), LEAST_TRAVEL)
        share = travel / travel.max()  # movej takes speed and acceleration of the leading axis; all axes arrive together (URScript manual)
        speed, acceleration = float(np.min(limits.speed / share)), float(np.min(limits.acceleration / share))
        if not (np.isfinite([speed, acceleration]).all() and min(speed, acceleration) > 0):
            raise ConfigError(f"{self._name}: speed and acceleration limits must be positive")
        if self._options.follow:
            raise SafetyStop(f"{self._name} is only followed (robot: follow); nothing was moved")
        with self._changed:
            self._check()
            self._command((*target.tolist(), speed, acceleration), MOVE)
            self._target, self._wanted, self._near_since, self._idle_since, self._longest_gap_s = target, limits, None, None, 0.0

    def set_output(self, number: int, value: bool) -> None:
        """Switch a standard digital output, one of the option digital_outputs; returns once it was sent. Raises ConfigError, and what
        stopped the arm."""
        if number not in self._options.digital_outputs:
            raise ConfigError(f"{self._name}: output {number} may not be switched from here; add it to the option digital_outputs")
        with self._changed:
            self._check()
            self._outputs = self._outputs | 1 << number if value else self._outputs & ~(1 << number)
            sent = self._life + 2  # the answer to the next package carries it
            if not self._changed.wait_for(lambda: self._error is not None or self._life >= sent, self._options.silence_s):
                raise DeviceTimeout(f"{self._name}: output {number} could not be switched, no package came; check controller and cable")
            self._check()

    @property
    def digital_outputs(self) -> tuple[int, ...]:
        """Numbers of the outputs that may be switched."""
        return self._options.digital_outputs

    def state(self) -> RobotState:
        """The latest state. Raises what stopped the arm."""
        with self._changed:
            self._check()
            latest, wanted = self._latest, self._wanted
            assert latest is not None, "a connected robot has a state"
            taken = latest["output_int_register_0"] == self._number
            if self._options.follow:
                return RobotState(float(latest["timestamp"]), np.array(latest["actual_q"]), bool(np.any(latest["actual_qd"])), False)
            moving = bool(latest["output_int_register_1"]) or (self._target is not None and not taken)
            rested = self._near_since is not None and wanted is not None and latest["timestamp"] - self._near_since >= wanted.settle_s
            arrived = self._target is not None and taken and not moving and rested
            return RobotState(float(latest["timestamp"]), np.array(latest["actual_q"]), moving, arrived)

    def cycles(self) -> Cycles:
        with self._changed:
            rows, self._rows = self._rows, []
        return Cycles({name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {})

    def stop(self) -> None:
        """Commands a stop, switches the outputs off, and waits for a moment until the controller took it up; an arm that is only followed
        is not ours to stop."""
        with self._changed:
            if self._options.follow or self._link is None or not self._link.open or self._error is not None:
                return
            self._target = None
            switched, self._outputs = self._outputs, 0
            sent = self._life + 2 if switched else self._life  # as for set_output
            self._command(self._registers[:8], STOP)
            self._changed.wait_for(lambda: self._error is not None or (self._at_rest() and self._life >= sent), self._options.silence_s)

    def close(self) -> None:
        self.stop()
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _forget(self) -> None:
        self._latest: Values | None = None
        self._taken_s: float | None = None
        self._longest_gap_s = 0.0  # between two packages since the move began
        self._error: MbcacqError | None = None
        self._target: np.ndarray | None = None
        self._wanted: MotionLimits | None = None
        self._near_since: float | None = None
        self._idle_since: float | None = None
        self._rows: list[dict[str, Any]] = []
        self._ready, self._number, self._life, self._outputs = False, 0, 0, 0
        self._registers: tuple[float, ...] = (*(0.0,) * 8, 0, STOP)

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._link is None or self._latest is None:
            raise ConnectError(f"{self._name} is not connected; connect it first")

    def _why(self) -> str:
        """Why it is not ready, '' if it is."""
        if self._latest is None:
            return "sends no data; restart the controller"
        return "" if self._options.follow else not_ready(self._latest, PROGRAM)

    def _check_payload(self) -> None:
        wanted = self._options.payload_kg
        assert self._latest is not None
        has = float(self._latest["payload"])
        if wanted is not None and abs(has - wanted) > self._options.payload_tolerance_kg:
            raise ConfigError(f"{self._name}: its payload is set to {has:.2f} kg, the plan says {wanted:.2f} kg; set it on the pendant")

    def _command(self, values: tuple[float, ...], kind: int) -> None:
        self._number = (self._number + 1) % LAST_NUMBER
        self._registers = (*values, self._number, kind)

    def _at_rest(self) -> bool:
        latest = self._latest
        return latest is not None and latest["output_int_register_0"] == self._number and not latest["output_int_register_1"]

    def _take(self, values: Values) -> Values:
        """A package of the controller (in the link's thread): the answer to it. Raises what ends the exchange."""
        if not np.isfinite([values["timestamp"], *values["actual_q"]]).all():
            raise ProtocolError(f"{self._name}: joint angles that are no numbers; the connection was given up")
        with self._changed:
            now, before = time.monotonic(), self._taken_s
            self._longest_gap_s, self._taken_s = max(self._longest_gap_s, 0.0 if before is None else now - before), now
            self._judge(values)
            command = values["target_q"] if self._target is None else tuple(self._target.tolist())
            row = {name: values[key] for name, key in COLUMNS.items()}
            self._rows.append({"time_s": values["timestamp"], "host_time_s": time.monotonic(), **row, "q_command": command})
            self._latest = values
            self._life = (self._life + 1) % 2**31
            self._changed.notify_all()
            doubles = {f"input_double_register_{k}": float(v) for k, v in enumerate(self._registers[:8])}
            number, kind = self._registers[8:]
            switched = {"standard_digital_output_mask": sum(1 << k for k in self._options.digital_outputs)}
            switched["standard_digital_output"] = self._outputs
            return {**doubles, **switched, "input_int_register_0": number, "input_int_register_1": kind, "input_int_register_2": self._life}

    def _judge(self, values: Values) -> None:
        """Raises SafetyStop or DeviceFault once it was ready and something stopped it. Whoever moves an arm that is only followed must stop
        it."""
        if self._options.follow:
            return
        if self._ready and (stop := safety_stop(values)):
            raise SafetyStop(f"{self._name} {stop}; then resume the run")
        if self._ready and values["runtime_state"] != PLAYING:
            raise DeviceFault(f"{self._name}: its program was stopped; see the pendant, start it again, then resume the run")
        self._ready = self._ready or not not_ready(values, PROGRAM)
        now, target, wanted = float(values["timestamp"]), self._target, self._wanted
        near = target is not None and wanted is not None and np.abs(np.array(values["actual_q"]) - target).max() <= wanted.tolerance
        self._near_since = (now if self._near_since is None else self._near_since) if near else None
        idle = target is not None and values["output_int_register_0"] == self._number and not values["output_int_register_1"]
        self._idle_since = (now if self._idle_since is None else self._idle_since) if idle and not near else None
        if self._idle_since is not None and now - self._idle_since > IDLE_S:
            raise DeviceFault(f"{self._name}: the move ended away from its target; {self._why_it_ended}then resume the run")

    @property
    def _why_it_ended(self) -> str:
        """What is known of a move that ended early: our program's watchdog stops an arm that has had no package from here for that long."""
        if self._longest_gap_s < WATCHDOG_S:
            return "see the pendant, "
        return (
            f"for {self._longest_gap_s:.2f} s this computer answered no package, and after {WATCHDOG_S:g} s the program on the controller "
            "stops the arm; look at the load of this computer and the network, see the pendant, "
        )

    def _fail(self, error: MbcacqError) -> None:
        with self._changed:
            self._error = error
            self._changed.notify_all()
