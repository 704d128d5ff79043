"""The controller's RTDE server: a client that sends registers is served in lock-step or in real time, one that listens by the clock."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbcacq_fakes.dynamics.ideal_arm import Kinematics
from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.idle import idle_s
from mbcacq_fakes.protocols.rtde.arm import ProgrammedArm
from mbcacq_fakes.protocols.rtde.variables import FORMAT, INPUTS, OUTPUTS, WIDTH
from mbcacq_fakes.protocols.stall import HANGING_S, STALL_S
from mbcacq_fakes.protocols.tcp_server import TcpServer

PROGRAM = 20261
WATCHDOG_S = 0.4
WAIT_S = 0.05  # for an answer at a time, in lock-step
CLOCK_START_S = 1000.0
HURRIED = 10.0  # in a dry run, of an arm that is led: times faster than the clock
NORMAL = 1  # bit 0 of safety_status_bits
# A UR10e as Universal Robots publish it: sign, theta, d, a, alpha of each joint; mm, deg.
UR10E = tuple(
    (1.0, 0.0, d, a, alpha)
    for d, a, alpha in ((180.7, 0, 90), (0, -612.7, 0), (0, -571.55, 0), (174.15, 0, 90), (119.85, 0, -90), (116.55, 0, 0))
)
GRAVITY = 9.82  # m/s^2, as the controller assumes it
FAULTS = {
    "safety_bits": "safety_status_bits, such as 4 for a protective stop; the arm halts while it is not 1",
    "robot_mode": "7 is running, 5 idle, 3 powered off",
    "runtime_state": "2 is playing, 1 stopped",
    "program": "number of the program that runs on it",
    "speed_fraction": "of the speed slider",
    "payload": "kg",
    "payload_cog": "m, its centre of gravity",
    "not_found": "set of variables that this version does not have",
    "in_use": "set of input registers that another client holds",
}


class FakeUrController(TcpServer):
    """start_deg: where the arm stands; dh: its rows, from which TCP poses follow; state: gets what it does, or None; realtime: packages by
    the clock. watchdog_s: the arm halts where the client is silent for longer; by default that of mbcacq_ur.script, in lock-step a
    computer's stall."""

    def __init__(
        self,
        state: Any = None,
        *,
        start_deg: Sequence[float] = (0.0, -90.0, 90.0, -90.0, -90.0, 0.0),
        dh: Sequence[Sequence[float]] = UR10E,
        realtime: bool = False,
        host: str = "127.0.0.1",
        port: int = 0,
        watchdog_s: float | None = None,
        **faults: Any,
    ) -> None:
        self._active: dict[str, Any] = {
            **{"safety_bits": NORMAL, "robot_mode": 7, "runtime_state": 2, "program": PROGRAM, "speed_fraction": 1.0},
            **{"payload": 2.3, "payload_cog": (0.0, 0.0, 0.032), "not_found": frozenset(), "in_use": frozenset()},
        }
        self.inputs: dict[str, Any] = {}  # what clients wrote, last
        self.lock = threading.Lock()  # of the arm and what is said of it
        self._conversations: list[_Conversation] = []
        self._kinematics = Kinematics(dh)
        self.inject(**faults)
        self.arm, self._realtime, self._state = ProgrammedArm(start_deg, state, CLOCK_START_S), realtime, state
        self.watchdog_s = watchdog_s if watchdog_s is not None else WATCHDOG_S if realtime else STALL_S
        super().__init__(host, port, one=False)
        self._led: np.ndarray | None = None
        self.outputs = 0  # bits of the standard digital outputs
        self.on_output: Callable[[int, bool], None] | None = None  # called with number and value of one that changes
        self.led = False  # somebody moves it: a client that only listens need not be served by the clock

    def lead(self, target: np.ndarray) -> None:
        """A person brings the arm to ``target`` (6,) rad; from any thread."""
        self._led, self.led = np.asarray(target, dtype=float), True

    def inject(self, **faults: Any) -> None:
        """See FAULTS. Raises ValueError."""
        refuse_unknown(faults, FAULTS)
        self._active |= faults

    def talk(self, connection: socket.socket) -> None:
        conversation = _Conversation(self, connection)
        self._conversations.append(conversation)
        with suppress(OSError, struct.error, ValueError, UnicodeDecodeError, KeyError):  # it is gone, or talks nonsense
            conversation.run()
        self._conversations.remove(conversation)
        if conversation.commands:
            self.halt()

    def is_clock(self, conversation: _Conversation) -> bool:
        """Whether the arm's time goes on with this conversation: with the first that commands, else with the first that listens."""
        started = [c for c in self._conversations if c.started]
        return conversation is next((c for c in started if c.commands), started[0] if started else None)

    def halt(self) -> None:
        with self.lock:
            self.arm.halt()

    @property
    def closing(self) -> bool:
        return self._quit.is_set()

    @property
    def realtime(self) -> bool:
        return self._realtime

    def known(self, names: Sequence[str], table: Mapping[str, str]) -> list[str]:
        """The types of variables, NOT_FOUND for what there is not, IN_USE for what another client writes."""

        def kind(name: str) -> str:
            if name in self._active["not_found"]:
                return "NOT_FOUND"
            return "IN_USE" if table is INPUTS and name in self._active["in_use"] else table.get(name, "NOT_FOUND")

        return [kind(name) for name in names]

    def advance(self, seconds: float) -> None:
        if self._active["safety_bits"] & ~3 or self._active["runtime_state"] != 2:
            self.arm.halt()
        led, self._led = self._led, None
        if led is not None:
            self.arm.lead(led)
        self.arm.advance(seconds, self._active["speed_fraction"])

    def obey(self, written: Mapping[str, Any]) -> None:
        """A client wrote these inputs."""
        self.inputs |= written
        registers = self.inputs
        if written.get("speed_slider_mask"):
            self._active["speed_fraction"] = float(np.clip(registers.get("speed_slider_fraction", 1.0), 0.0, 1.0))
        mask = registers.get("standard_digital_output_mask", 0)
        wanted = (self.outputs & ~mask) | (registers.get("standard_digital_output", 0) & mask)
        changed, self.outputs = wanted ^ self.outputs, wanted
        for number in range(8):
            if changed >> number & 1:
                self._tell_output(number, bool(wanted >> number & 1))
        if self._active["runtime_state"] == 2 and not self._active["safety_bits"] & ~3:
            self.arm.obey(registers)

    def _tell_output(self, number: int, value: bool) -> None:
        if self._state is not None:
            self._state.switch(number, value)
        if self.on_output is not None:
            self.on_output(number, value)

    def tcp_pose(self) -> list[float]:
        """x, y, z (m) and rotation vector (rad) of the flange, as the TCP is not set."""
        x, y, z, *abc = self._kinematics.pose(np.degrees(self.arm.q).tolist())
        return [1e-3 * x, 1e-3 * y, 1e-3 * z, *Rotation.from_euler("ZYX", abc, degrees=True).as_rotvec().tolist()]

    def tcp_speed(self) -> list[float]:
        """Its derivative (m/s, rad/s), by differences over a microsecond of this motion."""
        later = self._kinematics.pose(np.degrees(self.arm.q + 1e-6 * self.arm.qd).tolist())
        now = self._kinematics.pose(np.degrees(self.arm.q).tolist())
        turned = Rotation.from_euler("ZYX", later[3:], degrees=True) * Rotation.from_euler("ZYX", now[3:], degrees=True).inv()
        return [*(1e3 * (np.array(later[:3]) - now[:3])).tolist(), *(1e6 * turned.as_rotvec()).tolist()]

    def values(self) -> dict[str, Any]:
        """What it says of itself; all else is zero."""
        a, arm = self._active, self.arm
        pose, speed = self.tcp_pose(), self.tcp_speed()
        up = Rotation.from_rotvec(pose[3:]).inv().apply([0.0, 0.0, GRAVITY])
        return {
            **self.inputs,
            "timestamp": arm.time_s,
            "actual_q": arm.q.tolist(),
            "target_q": arm.q.tolist(),
            "actual_qd": arm.qd.tolist(),
            "target_qd": arm.qd.tolist(),
            "actual_TCP_pose": pose,
            "target_TCP_pose": pose,
            "actual_TCP_speed": speed,
            "target_TCP_speed": speed,
            "actual_tool_accelerometer": up.tolist(),
            "joint_temperatures": [30.0] * 6,
            "tool_temperature": 30.0,
            "actual_main_voltage": 48.0,
            "actual_robot_voltage": 48.0,
            "actual_joint_voltage": [48.0] * 6,
            "joint_mode": [253] * 6,  # running
            "robot_mode": a["robot_mode"],
            "safety_mode": 1 if a["safety_bits"] & 1 else 3,
            "safety_status": 1 if a["safety_bits"] & 1 else 3,
            "safety_status_bits": a["safety_bits"],
            "robot_status_bits": 3,
            "runtime_state": a["runtime_state"],
            "speed_scaling": arm.scale,
            "target_speed_fraction": a["speed_fraction"],
            "payload": a["payload"],
            "payload_cog": a["payload_cog"],
            "standard_analog_output0": self.inputs.get("standard_analog_output_0", 0.0),
            "standard_analog_output1": self.inputs.get("standard_analog_output_1", 0.0),
            "actual_digital_output_bits": self.outputs,
            "output_int_register_0": arm.taken,
            "output_int_register_1": int(arm.moving),
            "output_int_register_2": a["program"] if a["runtime_state"] == 2 else 0,
        }


class _Conversation:
    """One client."""

    def __init__(self, controller: FakeUrController, connection: socket.socket) -> None:
        self._controller, self._connection = controller, connection
        self._buffer = bytearray()
        self._sent: tuple[tuple[str, ...], list[str]] | None = None
        self._taken: dict[int, tuple[tuple[str, ...], list[str]]] = {}  # recipes of inputs by their number
        self._rate, self.started, self._answered = 125.0, False, True
        self._due, self._silent_s = time.monotonic(), 0.0

    @property
    def commands(self) -> bool:
        """Whether it writes inputs."""
        return bool(self._taken)

    def run(self) -> None:
        while not self._controller.closing:
            by_clock = not self.commands or self._controller.realtime
            now = time.monotonic()
            if self.started and (now >= self._due if by_clock else self._answered):
                if not by_clock and (sleep_s := idle_s(self._controller.arm.still_s)):
                    time.sleep(sleep_s)
                hurried = HURRIED if self._controller.led and not self._controller.realtime else 1.0
                self._due, self._answered = now + 1.0 / (hurried * self._rate), False
                with self._controller.lock:
                    if self._controller.is_clock(self):
                        self._controller.advance(1.0 / self._rate)
                    values = self._controller.values()
                self._send_data(values)
            wait_s = max(1e-3, self._due - now) if by_clock and self.started else WAIT_S
            self._connection.settimeout(wait_s)
            try:
                data = self._connection.recv(65536)
            except TimeoutError:
                # A computer that stood still held the client as well: the wait counts, not the clock.
                self._silent_s += wait_s
                if self.commands and self._silent_s > self._controller.watchdog_s:
                    self._controller.halt()
                continue
            if not data:
                return
            self._silent_s = 0.0
            self._buffer += data
            self._take_all()

    def _take_all(self) -> None:
        while len(self._buffer) >= 3:
            length, kind = struct.unpack_from(">HB", self._buffer)
            if length < 3:
                raise ValueError("no package")
            if len(self._buffer) < length:
                return
            payload = bytes(self._buffer[3:length])
            del self._buffer[:length]
            self._take(chr(kind), payload)

    def _take(self, kind: str, payload: bytes) -> None:
        match kind:
            case "V":
                self._send(kind, bytes([payload == b"\x00\x02"]))
            case "v":
                self._send(kind, struct.pack(">4I", 5, 15, 0, 0))
            case "O":
                self._rate = struct.unpack_from(">d", payload)[0]
                self._sent = self._setup(kind, payload[8:], OUTPUTS, 1)
            case "I":
                number = len(self._taken) + 1
                if (recipe := self._setup(kind, payload, INPUTS, number)) is not None:
                    self._taken[number] = recipe
            case "S" | "P":
                self.started = kind == "S" and self._sent is not None
                self._send(kind, b"\x01")
            case "U" if payload and payload[0] in self._taken:
                names, types = self._taken[payload[0]]
                flat = iter(struct.unpack(">" + "".join(FORMAT[t] for t in types), payload[1:]))
                read = [list(islice(flat, WIDTH[t])) if t in WIDTH else next(flat) for t in types]
                with self._controller.lock:
                    self._controller.obey(dict(zip(names, read, strict=True)))
                self._answered = True

    def _setup(self, kind: str, payload: bytes, table: Mapping[str, str], number: int) -> tuple[tuple[str, ...], list[str]] | None:
        """A recipe, which gets the number 0 and does not count if a variable is not to be had; the conversation goes on."""
        names = tuple(name for name in payload.decode("ascii").split(",") if name)  # some clients end the list by a comma
        types = self._controller.known(names, table)
        good = not {"NOT_FOUND", "IN_USE"} & set(types)
        self._send(kind, bytes([number if good else 0]) + ",".join(types).encode())
        return (names, types) if good else None

    def _send_data(self, values: Mapping[str, Any]) -> None:
        assert self._sent is not None
        (names, types), flat = self._sent, list[Any]()
        for name, kind in zip(names, types, strict=True):
            width = WIDTH.get(kind, 0)
            value = values.get(name, [0] * width if width else 0)
            flat += list(value) if width else [value]
        self._send("U", struct.pack(">B" + "".join(FORMAT[t] for t in types), 1, *flat))

    def _send(self, kind: str, payload: bytes) -> None:
        self._connection.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)


def start_in_cell(
    state: Any, *, start_deg: Sequence[float], dh: Any = UR10E, realtime: bool, ports: str, plan_options: Mapping[str, Any], **given: Any
) -> tuple[FakeUrController, dict[str, Any]]:
    """For the fake cell: a running controller, and the options that lead the driver to it."""
    faults = {name: value for name, value in given.items() if name in FAULTS}
    if plan_options.get("payload_kg") is not None and "payload" not in faults:
        faults["payload"] = float(plan_options["payload_kg"])
    port = 0 if ports == "free" else int(plan_options.get("port", 30004))
    slow = {} if realtime else {"watchdog_s": HANGING_S}
    fake = FakeUrController(state, start_deg=start_deg, dh=dh, realtime=realtime, port=port, **slow, **faults)
    return fake.start(), {"address": "127.0.0.1", "port": fake.port, **({} if realtime else {"silence_s": HANGING_S})}
