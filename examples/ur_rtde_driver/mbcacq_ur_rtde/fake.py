"""A fake UR controller that speaks RTDE on this computer and follows the registers as ``mbcacq_ur.script`` does."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np
import ruckig

from mbcacq_ur_rtde import protocol
from mbcacq_ur_rtde.protocol import Malformed, Packages, Recipe

KNOWN = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "target_q": "VECTOR6D", "actual_current": "VECTOR6D", "runtime_state": "UINT32"}
KNOWN |= {f"output_int_register_{k}": "INT32" for k in range(24)}
KNOWN |= {f"input_int_register_{k}": "INT32" for k in range(24)} | {f"input_double_register_{k}": "DOUBLE" for k in range(24)}
JERK = 500.0  # rad/s^3
WATCHDOG_S = 0.4


class FakeUr:
    """Context manager. start_deg: where the arm stands. realtime: packages by the clock, else each as soon as the last was answered.

    state: gets what the arm does by ``write(time_s, q, qd, direction, standstill, arrivals)``, or None.
    """

    def __init__(
        self,
        state: Any = None,
        *,
        start_deg: Sequence[float] = (0.0, -90.0, 90.0, -90.0, -90.0, 0.0),
        realtime: bool = False,
        port: int = 0,
    ):
        self._state, self._realtime = state, realtime
        self._q, self._qd, self._time = np.radians(np.array(start_deg, dtype=float)), np.zeros(6), 1000.0
        self._direction, self._arrivals = np.zeros(6), 0
        self._motion: ruckig.Trajectory | None = None
        self._since, self._taken, self._rate = 0.0, 0, 125.0
        self._outputs: Recipe | None = None
        self._inputs: Recipe | None = None
        self._started, self._answered = False, True
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.settimeout(0.2)
        self.port = self._server.getsockname()[1]
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="fake-ur", daemon=True)
        self.running = True  # whether the controller's program runs

    @property
    def q(self) -> np.ndarray:
        """(6,) rad."""
        return self._q.copy()

    @property
    def at_rest(self) -> bool:
        return self._motion is None

    def start(self) -> Self:
        self._thread.start()
        return self

    def stop(self) -> None:
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(5.0)
        self._server.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _serve(self) -> None:
        while not self._quit.is_set():
            try:
                connection, _ = self._server.accept()
            except TimeoutError:
                continue
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    self._talk(connection)
                except (OSError, Malformed, struct.error, UnicodeDecodeError, ValueError):
                    pass  # a client that is gone or talks nonsense
            self._halt()

    def _talk(self, connection: socket.socket) -> None:
        packages, last = Packages(), time.monotonic()
        self._outputs, self._inputs, self._started, self._answered = None, None, False, True
        while not self._quit.is_set():
            if self._started and self._outputs is not None and (self._answered or self._realtime):
                self._advance(1.0 / self._rate)
                connection.sendall(protocol.package(protocol.DATA_PACKAGE, self._outputs.pack(self._values(self._outputs))))
                self._answered = False
            connection.settimeout(max(1e-3, 1.0 / self._rate) if self._realtime else 0.05)
            try:
                data = connection.recv(65536)
            except TimeoutError:
                if time.monotonic() - last > WATCHDOG_S:
                    self._halt()
                continue
            if not data:
                return
            last = time.monotonic()
            for kind, payload in packages.feed(data):
                if kind == protocol.DATA_PACKAGE and self._inputs is not None:
                    self._obey(self._inputs.unpack(payload))
                    self._answered = True
                else:
                    self._answer(connection, kind, payload)

    def _answer(self, connection: socket.socket, kind: int, payload: bytes) -> None:
        """To anything but data."""
        if kind == protocol.SETUP_OUTPUTS:
            self._rate = struct.unpack_from(">d", payload)[0]
            self._outputs = self._setup(connection, kind, payload[8:], 1)
        elif kind == protocol.SETUP_INPUTS:
            self._inputs = self._setup(connection, kind, payload, 2)
        elif kind == protocol.START:
            self._started = self._outputs is not None
            connection.sendall(protocol.package(kind, bytes([self._started])))
        elif kind == protocol.REQUEST_PROTOCOL_VERSION:
            connection.sendall(protocol.package(kind, bytes([payload == b"\x00\x02"])))
        elif kind == protocol.GET_URCONTROL_VERSION:
            connection.sendall(protocol.package(kind, struct.pack(">4I", 5, 15, 0, 0)))

    def _setup(self, connection: socket.socket, kind: int, names: bytes, number: int) -> Recipe:
        wanted = names.decode("ascii").split(",")
        types = [KNOWN.get(name, "NOT_FOUND") for name in wanted]
        good = "NOT_FOUND" not in types
        connection.sendall(protocol.package(kind, bytes([number if good else 0]) + ",".join(types).encode()))
        if not good:
            raise Malformed("unknown variables")
        return Recipe(number, tuple(wanted), tuple(types))

    def _values(self, recipe: Recipe) -> list[Any]:
        values: dict[str, Any] = {
            "timestamp": self._time,
            "actual_q": self._q.tolist(),
            "target_q": self._q.tolist(),
            "actual_current": [0.0] * 6,
            "runtime_state": 2 if self.running else 1,
            "output_int_register_0": self._taken,
            "output_int_register_1": int(self._motion is not None),
        }
        return [values.get(name, 0) for name in recipe.names]

    def _obey(self, registers: Mapping[str, Any]) -> None:
        number = registers["input_int_register_0"]
        if number == self._taken:
            return
        self._taken = number
        if registers["input_int_register_1"] != 1:
            self._halt()
            return
        target = [registers[f"input_double_register_{k}"] for k in range(6)]
        speed, acceleration = registers["input_double_register_6"], registers["input_double_register_7"]
        wanted = ruckig.InputParameter(6)
        wanted.current_position, wanted.current_velocity, wanted.target_position = self._q.tolist(), self._qd.tolist(), target
        wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [speed] * 6, [acceleration] * 6, [JERK] * 6
        self._begin(wanted)

    def _halt(self) -> None:
        """As stopj: all axes to rest."""
        if self._motion is None:
            return
        wanted = ruckig.InputParameter(6)
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.current_position, wanted.current_velocity = self._q.tolist(), self._qd.tolist()
        wanted.target_velocity, wanted.max_acceleration, wanted.max_jerk = [0.0] * 6, [8.0] * 6, [JERK] * 6
        self._begin(wanted)
        while self._motion is not None:
            self._advance(0.002)

    def _begin(self, wanted: ruckig.InputParameter) -> None:
        motion = ruckig.Trajectory(6)
        ruckig.Ruckig(6).calculate(wanted, motion)
        self._motion, self._since = motion, 0.0

    def _advance(self, seconds: float) -> None:
        self._time += seconds
        if self._motion is not None:
            self._since = min(self._since + seconds, self._motion.duration)
            position, speed, _ = self._motion.at_time(self._since)
            moved = np.array(position) - self._q
            self._direction = np.where(np.abs(moved) > 1e-9, np.sign(moved), self._direction)
            self._q, self._qd = np.array(position), np.array(speed)
            if self._since >= self._motion.duration:
                self._motion, self._qd = None, np.zeros(6)
                self._arrivals += 1
        if self._state is not None:
            still = self._motion is None
            self._state.write(
                self._time, tuple(self._q.tolist()), tuple(self._qd.tolist()), tuple(self._direction.tolist()), still, self._arrivals
            )


def start_in_cell(state: Any, *, start_deg: Sequence[float], realtime: bool, ports: str, plan_options: Mapping[str, Any], **_: Any):
    """For mbcacq's fake cell: a running controller, and the options that lead the driver to it."""
    fake = FakeUr(state, start_deg=start_deg, realtime=realtime, port=0 if ports == "free" else int(plan_options.get("port", 30004)))
    return fake.start(), {"address": "127.0.0.1", "port": fake.port}
