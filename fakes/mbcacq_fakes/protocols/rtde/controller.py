"""The controller's RTDE server: a client that sends registers is served in lock-step or in real time, one that listens by the clock."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.idle import idle_s
from mbcacq_fakes.protocols.one_client_server import OneClientServer
from mbcacq_fakes.protocols.rtde.arm import ProgrammedArm
from mbcacq_fakes.protocols.rtde.variables import FORMAT, INPUTS, OUTPUTS, WIDTH
from mbcacq_fakes.protocols.stall import HANGING_S, STALL_S

PROGRAM = 20261
WATCHDOG_S = 0.4
WAIT_S = 0.05  # for an answer at a time, in lock-step
CLOCK_START_S = 1000.0
HURRIED = 10.0  # in a dry run, of an arm that is led: times faster than the clock
NORMAL = 1  # bit 0 of safety_status_bits
FAULTS = {
    "safety_bits": "safety_status_bits, such as 4 for a protective stop; the arm halts while it is not 1",
    "robot_mode": "7 is running, 5 idle, 3 powered off",
    "runtime_state": "2 is playing, 1 stopped",
    "program": "number of the program that runs on it",
    "speed_fraction": "of the speed slider",
    "payload": "kg",
    "not_found": "set of variables that this version does not have",
}


class FakeUrController(OneClientServer):
    """start_deg: where the arm stands; state: gets what it does, or None; realtime: packages by the clock. watchdog_s: the
    arm halts where the client is silent for longer; by default that of mbcacq_ur.script, in lock-step a computer's stall."""

    def __init__(
        self,
        state: Any = None,
        *,
        start_deg: Sequence[float] = (0.0, -90.0, 90.0, -90.0, -90.0, 0.0),
        realtime: bool = False,
        host: str = "127.0.0.1",
        port: int = 0,
        watchdog_s: float | None = None,
        **faults: Any,
    ) -> None:
        self._active: dict[str, Any] = {
            **{"safety_bits": NORMAL, "robot_mode": 7, "runtime_state": 2, "program": PROGRAM, "speed_fraction": 1.0, "payload": 2.3},
            "not_found": frozenset(),
        }
        self.inject(**faults)
        self.arm, self._realtime, self._state = ProgrammedArm(start_deg, state, CLOCK_START_S), realtime, state
        self.watchdog_s = watchdog_s if watchdog_s is not None else WATCHDOG_S if realtime else STALL_S
        super().__init__("fake-ur-controller", host, port)
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
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with suppress(OSError, struct.error, ValueError, UnicodeDecodeError, KeyError):  # a client that is gone, or talks nonsense
            _Conversation(self, connection).run()
        self.arm.halt()

    @property
    def closing(self) -> bool:
        return self._quit.is_set()

    @property
    def realtime(self) -> bool:
        return self._realtime

    def known(self, names: Sequence[str], table: Mapping[str, str]) -> list[str]:
        """The types of variables, NOT_FOUND for what there is not."""
        return ["NOT_FOUND" if name in self._active["not_found"] else table.get(name, "NOT_FOUND") for name in names]

    def advance(self, seconds: float) -> None:
        if self._active["safety_bits"] & ~3 or self._active["runtime_state"] != 2:
            self.arm.halt()
        led, self._led = self._led, None
        if led is not None:
            self.arm.lead(led)
        self.arm.advance(seconds)

    def obey(self, registers: Mapping[str, Any]) -> None:
        mask = registers.get("standard_digital_output_mask", 0)
        wanted = (self.outputs & ~mask) | (registers.get("standard_digital_output", 0) & mask)
        changed, self.outputs = wanted ^ self.outputs, wanted
        for number in range(8):
            if changed >> number & 1:
                self._tell_output(number, bool(wanted >> number & 1))
        if self._active["runtime_state"] == 2 and not self._active["safety_bits"] & ~3:
            self.arm.obey(registers, self._active["speed_fraction"])

    def _tell_output(self, number: int, value: bool) -> None:
        if self._state is not None:
            self._state.switch(number, value)
        if self.on_output is not None:
            self.on_output(number, value)

    def values(self) -> dict[str, Any]:
        """What it says of itself; all else is zero."""
        a, arm = self._active, self.arm
        return {
            "timestamp": arm.time_s,
            "actual_q": arm.q.tolist(),
            "target_q": arm.q.tolist(),
            "actual_qd": arm.qd.tolist(),
            "target_qd": arm.qd.tolist(),
            "joint_temperatures": [30.0] * 6,
            "joint_mode": [253] * 6,  # running
            "robot_mode": a["robot_mode"],
            "safety_mode": 1 if a["safety_bits"] & 1 else 3,
            "safety_status_bits": a["safety_bits"],
            "robot_status_bits": 3,
            "runtime_state": a["runtime_state"],
            "speed_scaling": a["speed_fraction"],
            "target_speed_fraction": a["speed_fraction"],
            "payload": a["payload"],
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
        self._taken: tuple[tuple[str, ...], list[str]] | None = None
        self._rate, self._started, self._answered = 125.0, False, True
        self._due, self._silent_s = time.monotonic(), 0.0

    def run(self) -> None:
        while not self._controller.closing:
            by_clock = self._taken is None or self._controller.realtime
            now = time.monotonic()
            if self._started and (now >= self._due if by_clock else self._answered):
                if not by_clock and (sleep_s := idle_s(self._controller.arm.still_s)):
                    time.sleep(sleep_s)
                hurried = HURRIED if self._controller.led and not self._controller.realtime else 1.0
                self._due, self._answered = now + 1.0 / (hurried * self._rate), False
                self._controller.advance(1.0 / self._rate)
                self._send_data()
            wait_s = max(1e-3, self._due - now) if by_clock and self._started else WAIT_S
            self._connection.settimeout(wait_s)
            try:
                data = self._connection.recv(65536)
            except TimeoutError:
                # A computer that stood still held the client as well: the wait counts, not the clock.
                self._silent_s += wait_s
                if self._taken is not None and self._silent_s > self._controller.watchdog_s:
                    self._controller.arm.halt()
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
                self._taken = self._setup(kind, payload, INPUTS, 2)
            case "S" | "P":
                self._started = kind == "S" and self._sent is not None
                self._send(kind, b"\x01")
            case "U" if self._taken is not None:
                names, types = self._taken
                flat = struct.unpack(">B" + "".join(FORMAT[t] for t in types), payload)[1:]
                self._controller.obey(dict(zip(names, flat, strict=True)))
                self._answered = True

    def _setup(self, kind: str, payload: bytes, table: Mapping[str, str], number: int) -> tuple[tuple[str, ...], list[str]]:
        names = tuple(name for name in payload.decode("ascii").split(",") if name)  # some clients end the list by a comma
        types = self._controller.known(names, table)
        good = "NOT_FOUND" not in types
        self._send(kind, bytes([number if good else 0]) + ",".join(types).encode())
        if not good:
            raise ValueError("a variable that there is not")
        return names, types

    def _send_data(self) -> None:
        assert self._sent is not None
        names, types = self._sent
        values, flat = self._controller.values(), list[Any]()
        for name, kind in zip(names, types, strict=True):
            width = WIDTH.get(kind, 0)
            value = values.get(name, [0] * width if width else 0)
            flat += list(value) if width else [value]
        self._send("U", struct.pack(">B" + "".join(FORMAT[t] for t in types), 1, *flat))

    def _send(self, kind: str, payload: bytes) -> None:
        self._connection.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)


def start_in_cell(
    state: Any, *, start_deg: Sequence[float], realtime: bool, ports: str, plan_options: Mapping[str, Any], **given: Any
) -> tuple[FakeUrController, dict[str, Any]]:
    """For the fake cell: a running controller, and the options that lead the driver to it."""
    faults = {name: value for name, value in given.items() if name in FAULTS}
    if plan_options.get("payload_kg") is not None and "payload" not in faults:
        faults["payload"] = float(plan_options["payload_kg"])
    port = 0 if ports == "free" else int(plan_options.get("port", 30004))
    slow = {} if realtime else {"watchdog_s": HANGING_S}
    fake = FakeUrController(state, start_deg=start_deg, realtime=realtime, port=port, **slow, **faults)
    return fake.start(), {"address": "127.0.0.1", "port": fake.port, **({} if realtime else {"silence_s": HANGING_S})}
