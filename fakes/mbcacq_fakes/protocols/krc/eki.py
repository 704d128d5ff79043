"""A fake EKI server with the schema of KUKA's external-control SDK: one client, requests in, status and events out."""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

START, RESET, CANCEL, DRIVES_ON, DRIVES_OFF = 1, 2, 3, 6, 7
_EVENTS = {RESET: 3, CANCEL: 2, 4: 6, DRIVES_ON: 9, DRIVES_OFF: 10, 8: 11}
_ERROR, _INVALID = 4, 7
_ROOT = re.compile(rb"<External\b([^<>]*?)(?:/>|>\s*</External\s*>)")
_ATTRIBUTE = re.compile(rb'(\w+)\s*=\s*"(-?\d{1,9})"')
_MAX_BUFFER = 65536


class FakeEki:
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
        self._host, self._port, self._model, self._answer, self._pause_s = host, port, model, answer, pause_s
        self._on_start, self._on_cancel = on_start, on_cancel
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self.emergency_stop = False
        self.drives = self.running = False
        self.requests: list[tuple[int, int, int]] = []
        self.port = port

    def start(self) -> Self:
        self._server = socket.create_server((self._host, self._port))
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
            self._server.close()
            self._thread = None

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _serve(self) -> None:
        while not self._closing.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            with client:
                client.settimeout(0.05)
                try:
                    self._talk(client)
                except OSError:
                    pass
            self.running = False

    def _talk(self, client: socket.socket) -> None:
        buffer = b""
        while not self._closing.is_set():
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
                self._handle(client, values.get("REQTYPE", 5), values.get("ControlMode", -1), values.get("CycleTime", -1))

    def _handle(self, client: socket.socket, request: int, control_mode: int, cycle_time: int) -> None:
        self.requests.append((request, control_mode, cycle_time))
        if request == 0:
            who = f'VER="1.2.0" NumAxes="6" NumExternalAxes="0" Model="{self._model}" RobVer="V8.6.11"'
            self._send(client, f"<Robot><Init {who}></Init></Robot>")
            self._send(client, self._status(control_mode, cycle_time))
            return
        event, text = self._event(request, control_mode, cycle_time)
        telegrams = [self._status(control_mode, cycle_time), f'<Robot><Response EventID="{event}">{text}</Response></Robot>']
        if self._answer == "merged":
            telegrams = ["".join(telegrams)]
        for telegram in telegrams:
            self._send(client, telegram)

    def _event(self, request: int, control_mode: int, cycle_time: int) -> tuple[int, str]:
        if request == START:
            if not self.drives or self.emergency_stop:
                return _ERROR, "drives are off"
            self.running = True
            if self._on_start is not None:
                self._on_start(control_mode, cycle_time)
            return 0, " "
        if request == CANCEL and not self.running:
            return _INVALID, "no program is running"
        if request == CANCEL:
            self.running = False
            if self._on_cancel is not None:
                self._on_cancel()
        if request in (DRIVES_ON, DRIVES_OFF):
            if self.emergency_stop and request == DRIVES_ON:
                return _ERROR, "emergency stop"
            self.drives = request == DRIVES_ON
        return _EVENTS.get(request, _INVALID), " "

    def _status(self, control_mode: int, cycle_time: int) -> str:
        return (
            f'<Robot><Status ControlMode="{control_mode}" CycleTime="{cycle_time}" DrivesPowered="{self.drives:d}" '
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
