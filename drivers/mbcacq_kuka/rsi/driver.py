"""KUKA robots over RSI, for mbcacq: the front of the cycle process."""

from __future__ import annotations

import atexit
import json
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

import numpy as np

from mbcacq.devices import (
    ConfigError,
    ConnectError,
    Cycles,
    Description,
    DeviceFault,
    DeviceTimeout,
    Field,
    MbcacqError,
    MotionLimits,
    ProtocolError,
    RobotState,
    SafetyStop,
)
from mbcacq_kuka.controller_files import rsi_files
from mbcacq_kuka.eki.client import EkiClient
from mbcacq_kuka.eki.start import start_by_eki
from mbcacq_kuka.rsi.options import read_options
from mbcacq_kuka.rsi.record import CycleReader
from mbcacq_kuka.rsi.shared import ARRIVED, CLOSE, MOVE, MOVING, STOP, RsiCommand, Shared

_FAULTS: dict[str, type[MbcacqError]] = {
    "connect": ConnectError,
    "protocol": ProtocolError,
    "silence": DeviceTimeout,
    "late": DeviceFault,
    "follow": SafetyStop,
    "refused": SafetyStop,
    "coarse": DeviceFault,
}
_AFTER = {
    "silence": "look at the smartPAD for the controller's message, then start its RSI program again",
    "late": "the arm was stopped",
    "follow": "the arm was stopped",
    "protocol": "the arm was stopped",
}


class KukaRsi:
    """A six-axis KUKA arm under RSI joint correction. ``options``: see options.Options. Implements mbcacq.devices.Robot."""

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model = name, model
        self._options = read_options(name, options)
        self._limits = np.array(self._options.limits_deg)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._shared: Shared | None = None
        self._reader: CycleReader | None = None
        self._eki: EkiClient | None = None
        self._move_seq = 0
        self._error: MbcacqError | None = None
        self.port = self._options.port
        self.real_time = False

    @staticmethod
    def controller_files(name: str, model: str, options: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
        """Path -> text of everything that goes onto the controller, for this plan. See controller_files.rsi_files."""
        return rsi_files(read_options(name, options), facts)

    def describe(self) -> Description:
        axes, rate = (6,), 1000.0 / self._options.cycle_ms
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
            ),
            verified_on_hardware=False,
        )

    def connect(self) -> None:
        """Wait for the controller's telegrams. Raises ConnectError (none came, port taken), ProtocolError (not usable)."""
        self.close()
        self._error, self._move_seq = None, 0
        try:
            self._shared = Shared.create()
        except OSError as error:
            raise ConnectError(
                f"robot '{self._name}': no shared memory for the RSI cycles ({error.strerror}); free some in /dev/shm"
            ) from error
        self._reader = CycleReader(self._shared)
        atexit.register(self.close)
        try:
            self._start()
            if self._options.eki:
                self._eki = start_by_eki(self._name, self._model, self._options)
            self._await_session()
        except BaseException:
            self.close()
            raise

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a joint motion to q (6,) rad. Raises SafetyStop for a target outside the limits, and any fault met so far."""
        self._check()
        target = np.degrees(np.asarray(q, dtype=float))
        if target.shape != (6,):
            raise ConfigError(f"robot '{self._name}': a target has 6 axes, not {np.shape(q)}")
        self._check_target(target)
        dynamics = [np.degrees(np.broadcast_to(np.asarray(v, dtype=float), (6,))) for v in (limits.speed, limits.acceleration, limits.jerk)]
        if not all(np.isfinite(v).all() and (v > 0).all() for v in dynamics):
            raise ConfigError(f"robot '{self._name}': speed, acceleration and jerk limits must be positive")
        if self._options.speed_deg_s is not None:
            dynamics[0] = np.minimum(dynamics[0], self._options.speed_deg_s)
        with self._lock:
            if self._shared is not None:
                self._move_seq = self._shared.send(
                    RsiCommand(MOVE, target.tolist(), *(v.tolist() for v in dynamics), float(np.degrees(limits.tolerance)), limits.settle_s)
                )

    def state(self) -> RobotState:
        self._check()
        with self._lock:
            row = self._reader.last()
        flags = int(row["flags"])
        arrived = self._move_seq > 0 and row["command"] >= self._move_seq and bool(flags & ARRIVED)
        moving = bool(flags & MOVING) or row["command"] < self._move_seq
        return RobotState(row["time_s"], np.radians(row["q"]), moving, arrived)

    def cycles(self) -> Cycles:
        with self._lock:
            return self._reader.drain() if self._reader is not None else Cycles({})

    def stop(self) -> None:
        with self._lock:
            if self._shared is not None:
                self._shared.send(RsiCommand(STOP))

    def close(self) -> None:
        atexit.unregister(self.close)
        process, self._process = self._process, None
        if process is not None:
            with self._lock:
                self._shared.send(RsiCommand(CLOSE))
            try:
                process.communicate(timeout=8.0)  # closes its input, waits until the arm stands
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        eki, self._eki = self._eki, None
        if eki is not None:
            eki.close()
        with self._lock:
            shared, self._shared = self._shared, None
            if shared is not None:
                self._reader.detach()
                shared.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _start(self) -> None:
        command = [sys.executable, "-m", "mbcacq_kuka.rsi.cycle"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._process.stdin.write(json.dumps({"shared": self._shared.name, **self._options.settings()}) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": "the RSI process did not start"}
        if "error" in answer:
            raise ConnectError(
                f"robot '{self._name}': cannot listen on {self._options.bind}:{self._options.port} ({answer['error']}); "
                "is another program using the port (KUKA's TestServer, a second mbcacq), is the address this computer's?"
            )
        self._shared.forget()
        self.port, self.real_time = answer["ready"], answer["real_time"]

    def _await_session(self) -> None:
        deadline = time.monotonic() + self._options.connect_timeout_s
        while self._shared.head == 0:
            self._check(connecting=True)
            if time.monotonic() > deadline:
                raise ConnectError(
                    f"robot '{self._name}': no RSI telegram arrived on {self._options.bind}:{self.port} within "
                    f"{self._options.connect_timeout_s:g} s; start the RSI program on the controller, and check that its Ethernet "
                    "configuration names this computer's address and port and that no firewall blocks UDP"
                )
            time.sleep(0.002)
        self._reader.begin()

    def _check(self, connecting: bool = False) -> None:
        """Raise what has stopped the arm."""
        if self._error is None:
            self._error = self._find_error(connecting)
        if self._error is not None:
            raise self._error.with_traceback(None)

    def _find_error(self, connecting: bool) -> MbcacqError | None:
        if self._shared is None or self._process is None:
            return ConnectError(f"robot '{self._name}' is not connected; call connect first")
        if (fault := self._shared.fault()) is not None:
            after = "" if connecting else _AFTER.get(fault["kind"], "")
            return _FAULTS[fault["kind"]](f"robot '{self._name}': {fault['text']}" + (f"; {after}" if after else ""))
        if (code := self._process.poll()) is not None:
            return DeviceFault(f"robot '{self._name}': the RSI process ended unexpectedly (exit code {code}); the controller stops the arm")
        if self._reader.lost:
            self.stop()
            return DeviceFault(
                f"robot '{self._name}': {self._reader.lost} cycles were lost because they were not fetched in time; the arm was stopped"
            )
        return None

    def _check_target(self, target: np.ndarray) -> None:
        low, high = self._limits.T
        where = "joint limits"
        if self._options.correction_limit_deg is not None:
            start, reach = self._reader.start, np.array(self._options.correction_limit_deg)
            narrow = (start - reach > low) | (start + reach < high)
            low, high = np.maximum(low, start - reach), np.minimum(high, start + reach)
            where = "limits of its RSI correction" if narrow.any() else where
        outside = ~(np.isfinite(target) & (target >= low - 1e-9) & (target <= high + 1e-9))
        if outside.any():
            axis = int(np.argmax(outside))
            raise SafetyStop(
                f"robot '{self._name}': A{axis + 1} would go to {target[axis]:.3f} deg, outside the {where} "
                f"{low[axis]:g}..{high[axis]:g} deg; nothing was moved"
            )
