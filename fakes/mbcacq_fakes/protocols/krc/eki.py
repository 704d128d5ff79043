"""A fake EKI server with the schema and the states of KUKA's external-control SDK: one client, requests in, status and events out.

Each connection begins INITIALIZED, without a control mode and with the cycle of 12 ms. CHANGE chooses the control mode and makes the server
INACTIVE, START starts the RSI program of the chosen mode and cycle (what START itself says of them counts for nothing) and makes it ACTIVE.
A command that a state does not allow is answered INVALID.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable

from mbcacq_fakes.protocols.tcp_server import TcpServer

CONNECT, START, RESET, CANCEL, CHANGE, NONE, DRIVES_ON, DRIVES_OFF, CYCLE = range(9)
INITIALIZED, INACTIVE, ACTIVE = "INITIALIZED", "INACTIVE", "ACTIVE"
ALLOWED = {
    INITIALIZED: {CONNECT, CHANGE, DRIVES_ON, DRIVES_OFF, CYCLE},
    INACTIVE: {START, CHANGE, CANCEL, DRIVES_ON, DRIVES_OFF, CYCLE},
    ACTIVE: {CANCEL, RESET},
}
_STARTED, _CANCELLED, _RESET_OK, _ERROR, _SWITCH_OK, _INVALID, _DRIVES_ON, _DRIVES_OFF, _CYCLE_SET = 0, 2, 3, 4, 6, 7, 9, 10, 11
_MODES = {1: "JOINT_POSITION", 2: "JOINT_IMPEDANCE"}
_NO_MODE, _CYCLE_4_MS, _CYCLE_12_MS = 0, 1, 2
_ROOT = re.compile(rb"<External\b([^<>]*?)(?:/>|>\s*</External\s*>)")
_ATTRIBUTE = re.compile(rb'(\w+)\s*=\s*"(-?\d{1,9})"')
_MAX_BUFFER = 65536


class FakeEki(TcpServer):
    """``on_start(control_mode, cycle_time)`` and ``on_cancel()`` are called when the client starts or ends the RSI program.

    ``answer``: how telegrams leave: 'plain', 'merged' (status and event in one segment), 'split' (byte by byte), 'junk' (padded as
    the SDK pads its own). ``pause_s``: the submit interpreter's 12 ms.
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        model: str = "#KR16R2010_2 C4 FLR",
        answer: str = "plain",
        pause_s: float = 0.012,
        on_start: Callable[[int, int], None] | None = None,
        on_cancel: Callable[[], None] | None = None,
    ) -> None:
        super().__init__(host, port)
        self._model, self._answer, self._pause_s = model, answer, pause_s
        self._on_start, self._on_cancel = on_start, on_cancel
        self.emergency_stop = False
        self.drives = self.running = False
        self._forget()
        self.requests: list[tuple[int, int, int]] = []

    def talk(self, connection: socket.socket) -> None:
        connection.settimeout(0.05)
        try:
            self._converse(connection)
        finally:
            self.running = False
            self._forget()

    def _forget(self) -> None:
        """A client that hangs up leaves nothing behind."""
        self.state, self.mode, self.cycle = INITIALIZED, _NO_MODE, _CYCLE_12_MS

    def _converse(self, client: socket.socket) -> None:
        buffer = b""
        while not self._quit.is_set():
            try:
                data = client.recv(4096)
            except TimeoutError:
                continue
            if not data or len(buffer) > _MAX_BUFFER:
                return
            buffer += data
            while (request := _ROOT.search(buffer)) is not None:
                buffer = buffer[request.end() :]
                values = {name.decode(): int(value) for name, value in _ATTRIBUTE.findall(request[1])}
                time.sleep(self._pause_s)
                self._handle(client, values.get("REQTYPE", NONE), values.get("ControlMode", -1), values.get("CycleTime", -1))

    def _handle(self, client: socket.socket, request: int, control_mode: int, cycle_time: int) -> None:
        self.requests.append((request, control_mode, cycle_time))
        if request == CONNECT and self.state == INITIALIZED:
            who = f'VER="1.2.0" NumAxes="6" NumExternalAxes="0" Model="{self._model}" RobVer="V8.6.11"'
            self._send(client, f"<Robot><Init {who}></Init></Robot>")
            self._send(client, self._status())
            return
        if request == NONE:
            self._send(client, self._status())
            return
        event, text = self._event(request, control_mode, cycle_time)
        telegrams = [self._status(), f'<Robot><Response EventID="{event}">{text}</Response></Robot>']
        if self._answer == "merged":
            telegrams = ["".join(telegrams)]
        for telegram in telegrams:
            self._send(client, telegram)

    def _event(self, request: int, control_mode: int, cycle_time: int) -> tuple[int, str]:
        if request not in ALLOWED[self.state]:
            return _INVALID, "Invalid transition requested"
        carry_out: dict[int, Callable[[], tuple[int, str]]] = {
            START: self._start_program,
            CANCEL: self._cancel,
            RESET: self._reset,
            CHANGE: lambda: self._change(control_mode),
            CYCLE: lambda: self._choose_cycle(cycle_time),
            DRIVES_ON: lambda: self._switch_drives(True),
            DRIVES_OFF: lambda: self._switch_drives(False),
        }
        return carry_out[request]()

    def _start_program(self) -> tuple[int, str]:
        if not self.drives or self.emergency_stop:
            return _ERROR, "drives are off"
        self.running, self.state = True, ACTIVE
        if self._on_start is not None:
            self._on_start(self.mode, self.cycle)
        return _STARTED, " "

    def _cancel(self) -> tuple[int, str]:
        if self.running and self._on_cancel is not None:
            self._on_cancel()
        self.running, self.state, self.mode = False, INITIALIZED, _NO_MODE
        return _CANCELLED, " "

    def _reset(self) -> tuple[int, str]:
        self.running, self.state = False, INACTIVE
        return _RESET_OK, " "

    def _change(self, control_mode: int) -> tuple[int, str]:
        if control_mode not in _MODES:
            return _ERROR, " "
        self.mode, self.state = control_mode, INACTIVE
        return _SWITCH_OK, _MODES[control_mode]

    def _choose_cycle(self, cycle_time: int) -> tuple[int, str]:
        if cycle_time not in (_CYCLE_4_MS, _CYCLE_12_MS):
            return _ERROR, " "
        self.cycle = cycle_time
        return _CYCLE_SET, " "

    def _switch_drives(self, on: bool) -> tuple[int, str]:
        if self.emergency_stop and on:
            return _ERROR, "emergency stop"
        self.drives = on
        return (_DRIVES_ON if on else _DRIVES_OFF), " "

    def _status(self) -> str:
        return (
            f'<Robot><Status ControlMode="{self.mode}" CycleTime="{self.cycle}" DrivesPowered="{self.drives:d}" '
            f'EmergencyStop="{self.emergency_stop:d}" GuardStop="0" InMotion="0" MotionPossible="{self.drives:d}" OperationMode="4" '
            f'RobotStopped="{not self.running:d}"></Status></Robot>'
        )

    def _send(self, client: socket.socket, telegram: str) -> None:
        data = telegram.encode()
        if self._answer == "junk":
            data += b"\n\0\0 x>y \xff" + bytes(40)
        if self._answer == "split":
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for i in range(len(data)):
                client.sendall(data[i : i + 1])
        else:
            client.sendall(data)
            time.sleep(0.002)  # SDK clients read one telegram a segment
