"""Universal Robots arms over RTDE, for mbcacq. The program ``mbcacq_ur.script`` must run on the controller."""

from __future__ import annotations

import socket
import struct
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
from mbcacq_ur_rtde import protocol
from mbcacq_ur_rtde.protocol import Malformed, Packages, Recipe

AXES = 6
OUTPUTS = ("timestamp", "actual_q", "target_q", "actual_current", "runtime_state", "output_int_register_0", "output_int_register_1")
INPUTS = (*(f"input_double_register_{k}" for k in range(8)), *(f"input_int_register_{k}" for k in range(3)))
PLAYING = 2  # runtime_state while a program runs
MOVE, STOP = 1, 2
NUMBERS = 2**30  # of commands, then they begin again
IDLE_S = 0.5  # on the controller's clock: idle for longer, and not at the target, it was stopped or went elsewhere
DEFAULTS: dict[str, Any] = {
    "address": None,
    "port": 30004,
    "frequency_hz": 125.0,
    "connect_timeout_s": 5.0,
    "silence_s": 1.0,
    "limits_deg": None,
    "speed_deg_s": None,
}


class UrRtde:
    """A six-axis UR arm. Options: see DEFAULTS; limits_deg and speed_deg_s come from the plan's robot file.

    Implements mbcacq.devices.Robot. The arm stops when the connection is lost: the controller's program has a watchdog.
    """

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        if unknown := sorted(set(options) - set(DEFAULTS)):
            raise ConfigError(f"robot '{name}': unknown option {', '.join(unknown)}; known are {', '.join(DEFAULTS)}; correct the plan")
        given = {**DEFAULTS, **options}
        if not given["address"]:
            raise ConfigError(f"robot '{name}': the option 'address' is missing; give the controller's IP address")
        limits = np.array(given["limits_deg"] if given["limits_deg"] is not None else [], dtype=float)
        if limits.shape != (AXES, 2) or not (limits[:, 0] < limits[:, 1]).all():
            raise ConfigError(f"robot '{name}': limits_deg of six axes are needed, the lower one first; give them in the robot file")
        self._name, self._model, self._options, self._limits = name, model, given, np.radians(limits)
        self._lock = threading.Condition()
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._quit = threading.Event()
        self._version = ""
        self._reset()

    def describe(self) -> Description:
        rate = float(self._options["frequency_hz"])
        return Description(
            "robot",
            self._model,
            (
                Field("time_s", "s", (), rate, "controller's clock (timestamp)"),
                Field("host_time_s", "s", (), rate, "monotonic clock of this computer on arrival"),
                Field("q", "rad", (AXES,), rate, "measured joint angles (actual_q)"),
                Field("q_set", "rad", (AXES,), rate, "set point (target_q)"),
                Field("q_command", "rad", (AXES,), rate, "target of the motion under way"),
                Field("current_A", "A", (AXES,), rate, "joint currents (actual_current)"),
            ),
            firmware=self._version,
            verified_on_hardware=False,
        )

    def connect(self) -> None:
        """Connect, agree on what is exchanged, and wait until the controller's program runs. Raises ConnectError, ProtocolError."""
        self.close()
        self._reset()
        self._quit = threading.Event()
        place = f"{self._options['address']}:{self._options['port']}"
        try:
            self._socket = socket.create_connection(
                (self._options["address"], int(self._options["port"])), self._options["connect_timeout_s"]
            )
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.settimeout(float(self._options["silence_s"]))
            self._agree()
        except TimeoutError as error:
            self.close()
            raise ConnectError(
                f"robot '{self._name}' at {place} does not answer; is RTDE enabled (Settings, Security, Services)?"
            ) from error
        except OSError as error:
            self.close()
            raise ConnectError(
                f"robot '{self._name}': no connection to {place} ({error.strerror or error}); check address and cable"
            ) from error
        except Malformed as error:
            self.close()
            raise ProtocolError(f"robot '{self._name}' at {place} does not speak RTDE version 2: {error}") from error
        except MbcacqError:
            self.close()
            raise
        self._thread = threading.Thread(target=self._receive, args=(self._socket, self._quit), name="ur-rtde", daemon=True)
        self._thread.start()
        self._await_program(place)

    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a movej to q (6,) rad, at the speed and acceleration of the slowest axis allowed. Raises SafetyStop outside the limits."""
        target = np.asarray(q, dtype=float)
        if target.shape != (AXES,):
            raise ConfigError(f"robot '{self._name}': a target has {AXES} axes, not {np.shape(q)}")
        low, high = self._limits.T
        outside = ~np.isfinite(target) | (target < low - 1e-9) | (target > high + 1e-9)
        if outside.any():
            axis = int(np.argmax(outside))
            raise SafetyStop(
                f"robot '{self._name}': A{axis + 1} would go to {np.degrees(target[axis]):.3f}°, beyond its limits "
                f"{np.degrees(low[axis]):g}..{np.degrees(high[axis]):g}°; nothing was moved"
            )
        speed, acceleration = float(np.min(limits.speed)), float(np.min(limits.acceleration))
        if not (np.isfinite([speed, acceleration]).all() and speed > 0 and acceleration > 0):
            raise ConfigError(f"robot '{self._name}': speed and acceleration limits must be positive")
        with self._lock:
            self._check()
            self._number = (self._number + 1) % NUMBERS
            self._command = (*target.tolist(), speed, acceleration, self._number, MOVE)
            self._target, self._limits_now, self._near_since, self._idle_since = target, limits, None, None

    def state(self) -> RobotState:
        with self._lock:
            self._check()
            latest, target, limits = self._latest, self._target, self._limits_now
            assert latest is not None, "a connected robot has a state"
            q = np.array(latest["actual_q"])
            taken = latest["output_int_register_0"] == self._number
            moving = bool(latest["output_int_register_1"]) or (target is not None and not taken)
            arrived = False
            if target is not None and limits is not None and taken and not moving and self._near_since is not None:
                arrived = float(latest["timestamp"]) - self._near_since >= limits.settle_s
            return RobotState(float(latest["timestamp"]), q, moving, arrived)

    def cycles(self) -> Cycles:
        with self._lock:
            rows, self._rows = self._rows, []
        if not rows:
            return Cycles({})
        names = ("time_s", "host_time_s", "q", "q_set", "q_command", "current_A")
        return Cycles({name: np.array([row[k] for row in rows]) for k, name in enumerate(names)})

    def stop(self) -> None:
        """Commands a stop and waits for a moment until the controller took it up."""
        with self._lock:
            if self._socket is None or self._error is not None:
                return
            self._target = None
            self._number = (self._number + 1) % NUMBERS
            self._command = (*self._command[:8], self._number, STOP)
            self._lock.wait_for(lambda: self._error is not None or self._resting(), timeout=float(self._options["silence_s"]))

    def close(self) -> None:
        self.stop()
        self._quit.set()
        connection, self._socket = self._socket, None
        if connection is not None:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            connection.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)
        self._thread = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _reset(self) -> None:
        self._latest: dict[str, Any] | None = None
        self._error: MbcacqError | None = None
        self._target: np.ndarray | None = None
        self._limits_now: MotionLimits | None = None
        self._near_since: float | None = None
        self._idle_since: float | None = None
        self._rows: list[tuple[Any, ...]] = []
        self._number = 0
        self._command: tuple[Any, ...] = (*(0.0,) * 8, 0, STOP)
        self._packages = Packages()
        self._pending: list[tuple[int, bytes]] = []
        self._life = 0

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._socket is None:
            raise ConnectError(f"robot '{self._name}' is not connected; connect it first")

    def _resting(self) -> bool:
        latest = self._latest
        return latest is not None and latest["output_int_register_0"] == self._number and not latest["output_int_register_1"]

    def _agree(self) -> None:
        """Version, outputs, inputs, start."""
        answer = self._ask(protocol.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 2))
        if answer != b"\x01":
            raise Malformed("the version is refused")
        version = self._ask(protocol.GET_URCONTROL_VERSION)
        if len(version) == 16:
            self._version = ".".join(map(str, struct.unpack(">4I", version)))
        names = struct.pack(">d", float(self._options["frequency_hz"])) + ",".join(OUTPUTS).encode()
        self._outputs = protocol.recipe(OUTPUTS, self._ask(protocol.SETUP_OUTPUTS, names))
        self._inputs: Recipe = protocol.recipe(INPUTS, self._ask(protocol.SETUP_INPUTS, ",".join(INPUTS).encode()))
        if self._ask(protocol.START) != b"\x01":
            raise Malformed("the exchange is refused")

    def _ask(self, kind: int, payload: bytes = b"") -> bytes:
        """The answer of the same type to a package; text messages in between are passed over."""
        connection = self._socket
        assert connection is not None
        connection.sendall(protocol.package(kind, payload))
        deadline = time.monotonic() + float(self._options["silence_s"])
        while True:
            while self._pending:
                found, content = self._pending.pop(0)
                if found == kind:
                    return content
                if found not in (protocol.TEXT_MESSAGE, protocol.DATA_PACKAGE):
                    raise Malformed(f"a package of type {found} instead of {kind}")
            if time.monotonic() > deadline:
                raise TimeoutError
            data = connection.recv(4096)
            if not data:
                raise ConnectionResetError("the controller ended the connection")
            self._pending += self._packages.feed(data)

    def _await_program(self, place: str) -> None:
        with self._lock:
            ready = self._lock.wait_for(
                lambda: self._error is not None or (self._latest or {}).get("runtime_state") == PLAYING,
                timeout=self._options["connect_timeout_s"],
            )
            error = self._error
            if self._latest is not None:
                self._number = int(self._latest["output_int_register_0"])
        if error is not None:
            self.close()
            raise ConnectError(f"robot '{self._name}' at {place}: {error}")
        if not ready:
            self.close()
            raise ConnectError(f"robot '{self._name}' at {place}: no program runs; load mbcacq_ur.script on the controller and press play")

    def _receive(self, connection: socket.socket, quit_event: threading.Event) -> None:
        """Thread: takes every package, answers each with the command, until the connection ends or something is wrong."""
        try:
            while not quit_event.is_set():
                for kind, payload in self._pending or ():
                    self._take(connection, kind, payload)
                self._pending = []
                data = connection.recv(65536)
                if not data:
                    raise ConnectError(f"robot '{self._name}': the controller ended the connection; the arm stops by its watchdog")
                self._pending = self._packages.feed(data)
        except TimeoutError:
            self._fail(DeviceTimeout(f"robot '{self._name}': silent for {self._options['silence_s']:g} s; the arm stops by its watchdog"))
        except (Malformed, struct.error) as error:
            self._fail(ProtocolError(f"robot '{self._name}': {error}; the connection was given up, the arm stops by its watchdog"))
        except MbcacqError as error:
            self._fail(error)
        except OSError as error:
            if not quit_event.is_set():
                self._fail(ConnectError(f"robot '{self._name}': the connection broke ({error.strerror or error}); check the cable"))

    def _take(self, connection: socket.socket, kind: int, payload: bytes) -> None:
        if kind != protocol.DATA_PACKAGE:
            return
        values, now = self._outputs.unpack(payload), time.monotonic()
        if not np.isfinite([values["timestamp"], *values["actual_q"]]).all():
            raise Malformed("joint angles that are no numbers")
        with self._lock:
            if self._latest is not None and values["runtime_state"] != PLAYING and self._latest["runtime_state"] == PLAYING:
                raise DeviceFault(f"robot '{self._name}': its program was stopped; see the pendant, then start it again")
            target, limits = self._target, self._limits_now
            near = target is not None and limits is not None and np.abs(np.array(values["actual_q"]) - target).max() <= limits.tolerance
            self._near_since = (float(values["timestamp"]) if self._near_since is None else self._near_since) if near else None
            idle = target is not None and values["output_int_register_0"] == self._number and not values["output_int_register_1"]
            self._idle_since = (float(values["timestamp"]) if self._idle_since is None else self._idle_since) if idle else None
            if self._idle_since is not None and not near and float(values["timestamp"]) - self._idle_since > IDLE_S:
                raise DeviceFault(f"robot '{self._name}': the move ended away from its target; see the pendant (a protective stop?)")
            command = values["target_q"] if target is None else tuple(target.tolist())
            self._rows.append((values["timestamp"], now, values["actual_q"], values["target_q"], command, values["actual_current"]))
            self._latest = values
            self._life += 1
            answer = self._inputs.pack((*self._command, self._life % 2**31))
            self._lock.notify_all()
        connection.sendall(protocol.package(protocol.DATA_PACKAGE, answer))

    def _fail(self, error: MbcacqError) -> None:
        with self._lock:
            self._error = error
            self._lock.notify_all()
