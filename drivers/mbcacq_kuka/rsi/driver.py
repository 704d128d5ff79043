"""KUKA robots over RSI, for mbcacq: the front of the cycle process."""

from __future__ import annotations

import atexit
import logging
import time
from collections.abc import Mapping
from math import isfinite
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
    SystemRefused,
    joint_target,
    parse_options,
    signals_deferred,
)
from mbcacq_kuka.controller_files import rsi_files
from mbcacq_kuka.option_values import check_output
from mbcacq_kuka.rsi.cycle_process import CycleProcess
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.record import WATCHED
from mbcacq_kuka.rsi.shared import ALL_OUTPUTS, ARRIVED, MOVE, MOVING, STOP, RsiCommand
from mbcacq_kuka.rsi.telegram import REPORT_ELEMENT, output_attribute

_FAULTS: dict[str, type[MbcacqError]] = {
    "connect": ConnectError,
    "protocol": ProtocolError,
    "restart": ProtocolError,
    "implausible": SafetyStop,
    "silence": DeviceTimeout,
    "late": DeviceFault,
    "follow": SafetyStop,
    "refused": SafetyStop,
    "relative": SafetyStop,
    "coarse": DeviceFault,
}
_AFTER = {
    "silence": "look at the smartPAD for the controller's message, then start its RSI program again",
    "late": "the arm was stopped",
    "follow": "the arm was stopped",
    "relative": "the arm was stopped",
    "protocol": "the arm was stopped",
    "implausible": "the arm was stopped",
}
_POLL_S = 0.002
_FINE_DECIMALS = 4  # with which rounding is below the repeatability of any joint
_log = logging.getLogger("mbcacq.kuka_rsi")


class KukaRsi(ContextDevice):
    """A six-axis KUKA arm under RSI joint correction. ``options``: see options.Options. Implements mbcacq.devices.Robot."""

    plan_facts = ("dynamics", "follow")

    options_model = RsiOptions
    first_contact = (
        "The cable goes from a network card of this computer straight to the controller's KLI or RSI port; `ping` answers in under 1 ms.",
        "`mbcacq controller-files {plan} --out files`; the files are on the controller, and WARNINGS.txt is absent or understood.",
        "In T1 select the RSI program and start it. The smartPAD shows no message of RSI; `mbcacq doctor {plan} --arm` finds the robot. "
        "Note KSS and RSI versions.",
        "The angles that doctor and the viewer show agree with the smartPAD's axis display to 0.001°, A1 to A6, signs too.",
        "Delay stays 0 for a minute (column delay of the recording); note the largest gap between telegrams.",
        "Stop the program on the smartPAD: the run ends with the sentence that the controller fell silent.",
        "Only if the plan names digital_outputs: the smartPAD's outputs show each on for the pulse of an exposure, then off; "
        "stop a run in a pulse: it goes off.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model = name, model
        self._options = parse_options(RsiOptions, f"robot '{name}'", options)
        self._limits = np.array(self._options.limits_deg)
        self._process: CycleProcess | None = None
        self._move_seq = 0
        self._error: MbcacqError | None = None
        self.port = self._options.port
        self.real_time = False

    @staticmethod
    def controller_files(name: str, model: str, options: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
        """Path -> text of everything that goes onto the controller, for this plan. See controller_files.rsi_files."""
        return rsi_files(parse_options(RsiOptions, f"robot '{name}'", options), facts)

    def describe(self) -> Description:
        axes, rate, outputs = (6,), 1000.0 / self._options.cycle_ms, self._options.digital_outputs
        named = ", ".join(f"$OUT[{number}]" for number in outputs)
        switched = (Field("digital_outputs", "1", (len(outputs),), rate, f"{named} (Digout); 1 is on"),) if outputs else ()
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "robot clock (IPOC)"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer on arrival"),
                Field("q", "rad", axes, rate, "measured axis angles (AIPos)"),
                Field("q_set", "rad", axes, rate, "set axis angles without correction (ASPos); NaN if not sent"),
                Field("q_command", "rad", axes, rate, "axis angles asked for in the answer"),
                Field("current_percent", "%", axes, rate, "motor currents (MACur), as sent"),
                Field("delay", "1", (), rate, "answers the controller counted late"),
                Field("ipoc", "ms", (), rate, "the controller's cycle counter"),
                Field("external_axes", "deg or mm", axes, rate, "external axes E1 to E6 (EIPos), as sent; only if sent"),
                *switched,
                Field("lost_telegrams", "1", (), rate, "telegrams that never arrived, since the session began"),
                Field("repeated_telegrams", "1", (), rate, "telegrams that arrived again"),
                Field("old_telegrams", "1", (), rate, "telegrams that arrived after a later one"),
                Field("foreign_telegrams", "1", (), rate, "datagrams of other senders, until the operating system dropped them"),
            ),
            verified_on_hardware=False,
        )

    def facts(self) -> tuple[Fact, ...]:
        """What the controller's program found as it began; none from programs that say nothing of it, as on iiQKA.OS2."""
        if self._process is None:
            return ()
        load, *numbers = (self._process.newest(f"{WATCHED}{k}") for k in (1, 2, 3))
        known = (Fact("load", load, "kg", 0.05),) if load >= 0 else ()
        return (*known, *(Fact(name, number) for name, number in zip(("tool", "base"), numbers, strict=True) if isfinite(number)))

    def connect(self) -> None:
        """Wait for the controller's telegrams. Raises ConnectError (none came, port taken), ProtocolError (not usable),
        SystemRefused (no shared memory)."""
        self.close()
        self._error, self._move_seq = None, 0
        atexit.register(self.close)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a joint motion to q (6,) rad. Raises SafetyStop for a target outside the limits and for an arm that is only followed, and
        any fault met so far."""
        if self._options.follow:
            raise SafetyStop(f"robot '{self._name}' is only followed (robot: follow); nothing was moved")
        process = self._check()
        self._move_seq = process.send(self._command(self._checked(process, q), limits))

    def set_output(self, number: int, value: bool) -> None:
        """Switch $OUT[number], one of the option digital_outputs; returns once the controller reports it so. It is switched off by
        ``stop``, by every fault and by the end of the session, too.

        Raises ConfigError, DeviceTimeout (not switched), DeviceFault (off meanwhile), and what stopped the arm."""
        check_output(self._name, number, self._options.digital_outputs)
        process, bit = self._check(), 1 << self._options.digital_outputs.index(number)
        process.switch(bit, value)
        deadline = time.monotonic() + self._options.silence_s
        while (process.newest(f"{REPORT_ELEMENT}.{output_attribute(number)}") > 0.5) != value:
            if (now := self._check()) is not process or now.is_switched(bit) != value:
                raise DeviceFault(f"robot '{self._name}': output {number} was switched off meanwhile, by a stop or a new session")
            if time.monotonic() > deadline:
                process.switch(bit, False)
                raise DeviceTimeout(
                    f"robot '{self._name}': output {number} was switched {'on' if value else 'off'}, but the controller reports it "
                    f"{'off' if value else 'on'}; is it write-protected, or does another program set it?"
                )
            time.sleep(_POLL_S)

    @property
    def digital_outputs(self) -> tuple[int, ...]:
        """Numbers of the outputs that may be switched."""
        return self._options.digital_outputs

    def state(self) -> RobotState:
        process = self._check()
        row = process.last()
        flags = int(row["flags"])
        arrived = self._move_seq > 0 and row["command"] >= self._move_seq and bool(flags & ARRIVED)
        moving = bool(flags & MOVING) or row["command"] < self._move_seq
        return RobotState(row["time_s"], np.radians(row["q"]), moving, arrived)

    def cycles(self) -> Cycles:
        return Cycles({}) if self._process is None else self._process.drain()

    def stop(self) -> None:
        if self._process is not None:
            self._process.switch(ALL_OUTPUTS, False)
            self._process.send(RsiCommand(STOP))

    def close(self) -> None:
        atexit.unregister(self.close)
        if self._process is not None:
            self._process.close()

    def _open(self) -> None:
        """A session with the controller. Raises ConnectError, ProtocolError, SystemRefused."""
        try:
            with signals_deferred():
                process = self._process = CycleProcess()
        except OSError as error:
            raise SystemRefused(
                f"robot '{self._name}': no shared memory for the RSI cycles ({error.strerror}); "
                "free some in /dev/shm, which must be writable"
            ) from error
        if problem := process.start(self._options.settings()):
            raise ConnectError(
                f"robot '{self._name}': cannot listen on {self._options.bind}:{self._options.port} ({problem}); "
                "is another program using the port (KUKA's TestServer, a second mbcacq), is the address this computer's?"
            )
        self.port, self.real_time = process.port, process.real_time
        deadline = time.monotonic() + self._options.connect_timeout_s
        while not process.connected:
            if (error := self._find_error(process, connecting=True)) is not None:
                raise error
            if time.monotonic() > deadline:
                raise ConnectError(f"robot '{self._name}': {self._nothing_came(process)}")
            time.sleep(_POLL_S)
        process.begin()
        if process.decimals < _FINE_DECIMALS:
            _log.warning(
                "robot '%s': the controller writes joint angles with %d decimal%s only, which is rounding to %g°: as much as the "
                "joints of some arms scatter; set Precision to 6 at the ETHERNET object of its RSI context",
                self._name,
                process.decimals,
                "s" * (process.decimals != 1),
                10.0**-process.decimals,
            )

    def _nothing_came(self, process: CycleProcess) -> str:
        """Why the session has not begun in time: what came, and what did not."""
        heard, sender, discarded = process.noted()
        wait_s = self._options.connect_timeout_s
        if not heard:
            return (
                f"no RSI telegram arrived on {self._options.bind}:{self.port} within {wait_s:g} s; start the RSI program on the "
                "controller, and check that its Ethernet configuration names this computer's address and port and that no firewall "
                "blocks UDP"
            )
        came = "one telegram came" if heard == 1 else f"{heard} telegrams came"
        unused = f"; it discarded {discarded} of the answers (its Delay), so compare sen_type '{self._options.sen_type}' with its SENTYPE"
        return (
            f"{came} from {sender} within {wait_s:g} s, and then none, too few to begin a session: the network is fine in this direction, "
            "but the controller ended its RSI program, as after the Timeout of its ETHERNET object or a stop; read the message on the "
            "smartPAD, then start the program again" + (unused if discarded else "")
        )

    def _command(self, target: np.ndarray, limits: MotionLimits) -> RsiCommand:
        dynamics = [np.degrees(np.broadcast_to(np.asarray(v, dtype=float), (6,))) for v in (limits.speed, limits.acceleration, limits.jerk)]
        if not all(np.isfinite(v).all() and (v > 0).all() for v in dynamics):
            raise ConfigError(f"robot '{self._name}': speed, acceleration and jerk limits must be positive")
        speed, acceleration, jerk = (np.minimum(v, most).tolist() for v, most in zip(dynamics, self._options.dynamics, strict=True))
        return RsiCommand(MOVE, target.tolist(), speed, acceleration, jerk, float(np.degrees(limits.tolerance)), limits.settle_s)

    def _check(self) -> CycleProcess:
        """The running session. Raises what has stopped the arm."""
        process = self._process
        if process is None or not process.open:
            raise self._error or ConnectError(f"robot '{self._name}' is not connected; call connect first")
        self._error = self._error or self._find_error(process)
        if self._error is not None:
            raise self._error.with_traceback(None)
        return process

    def _find_error(self, process: CycleProcess, connecting: bool = False) -> MbcacqError | None:
        if (fault := process.fault()) is not None:
            after = "" if connecting else _AFTER.get(fault["kind"], "")
            return _FAULTS[fault["kind"]](f"robot '{self._name}': {fault['text']}" + (f"; {after}" if after else ""))
        if (code := process.exit_code) is not None:
            return DeviceFault(f"robot '{self._name}': the RSI process ended unexpectedly (exit code {code}); the controller stops the arm")
        if process.lost:
            self.stop()
            return DeviceFault(
                f"robot '{self._name}': {process.lost} cycles were lost because they were not fetched in time; the arm was stopped"
            )
        return None

    def _checked(self, process: CycleProcess, q: np.ndarray) -> np.ndarray:
        """A target (6,) rad in deg. Raises ConfigError, SafetyStop."""
        low, high = self._limits.T
        where = "joint limits"
        if self._options.correction_limit_deg is not None:
            start, reach = process.start_deg, np.array(self._options.correction_limit_deg)
            narrow = (start - reach > low) | (start + reach < high)
            low, high = np.maximum(low, start - reach), np.minimum(high, start + reach)
            where = "limits of its RSI correction" if narrow.any() else where
        return np.degrees(joint_target(f"robot '{self._name}'", q, np.radians(np.stack([low, high], axis=1)), where))
