"""Programs that clients upload: the ports on which they do so, and the program of ``ur_rtde`` as the controller runs it.

Numbers of commands and registers as ``ur_rtde`` 1.6 sends and reads them.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from typing import Any

import numpy as np

from mbcacq_fakes.protocols.rtde.arm import BRAKE, JERK, ProgrammedArm
from mbcacq_fakes.protocols.tcp_server import TcpServer

READY, DONE = 1, 2  # of output_int_register_0
RUNNING = 1 << 15  # of output_int_register_2: what was begun asynchronously goes on; its number stands in bits 24 to 30
STOPS = (15, 16, 33, 34)  # of speed, servo, a line, joints
_log = logging.getLogger("mbcacq.fakes.rtde")


class UploadedProgram:
    """moveJ, moveL and their kin, stops, payload, forward and inverse kinematics; any other command ends it, with a sentence in the log."""

    def __init__(self, arm: ProgrammedArm, end: Callable[[], object], take_payload: Callable[[float], object]) -> None:
        self._arm, self._end, self._take_payload = arm, end, take_payload
        self._state, self._begun, self._asynchronous = READY, 0, False
        self._waits = False  # done once the arm stands
        self._results: dict[str, Any] = {}

    def registers(self) -> dict[str, Any]:
        """The output registers now."""
        moving = self._arm.moving
        if self._waits and not moving:
            self._state, self._waits = DONE, False
        progress = (self._begun % 128) << 24 | (RUNNING if self._asynchronous and moving else 0)
        return {**self._results, "output_int_register_0": self._state, "output_int_register_2": progress}

    def obey(self, written: dict[str, Any]) -> None:
        command = written.get("input_int_register_0", 0)
        values = [written.get(f"input_double_register_{k}", 0.0) for k in range(8)]
        if command == 0:
            self._state = READY
        elif command == 255:
            self._end()
        elif self._state == READY and not self._waits:
            try:
                self._do(command, values, bool(written.get("input_int_register_1", 0)))
            except ValueError as error:
                _log.warning("the uploaded program was ended: %s", error)
                self._end()

    def _do(self, command: int, values: list[float], asynchronous: bool) -> None:
        """Raises ValueError for what the arm cannot do."""
        arm, at = self._arm, np.array(values[:6])
        if command in (1, 2):
            arm.go(at if command == 1 else arm.joints_at(at, arm.q), values[6], values[7], JERK)
        elif command in (3, 4):
            arm.go_along(*arm.line(at if command == 3 else arm.flange_pose(at)), values[6], values[7])
        elif command in STOPS:
            arm.brake(max(values[0], BRAKE) if command != 33 else BRAKE, JERK)
        elif command == 17:
            self._take_payload(values[0])
        elif command in (43, 46):
            found = arm.flange_pose(arm.q) if command == 43 else arm.joints_at(at, arm.q)
            self._results = {f"output_double_register_{k}": float(found[k]) for k in range(6)}
        elif command == 47:
            self._results = {"output_int_register_1": int(not arm.moving)}
        else:
            raise ValueError(f"the fake does nothing for command {command} (servo, speed and force are not played)")
        self._asynchronous = asynchronous
        self._begun += asynchronous
        self._waits = not asynchronous
        self._state = DONE if asynchronous else self._state


class Dashboard(TcpServer):
    """The dashboard server, as far as clients look at it before they upload. playing, stop: of the controller's program."""

    def __init__(self, playing: Callable[[], bool], stop: Callable[[], object], host: str, port: int = 29999) -> None:
        super().__init__(host, port, one=False)
        self._playing, self._stop = playing, stop

    def talk(self, connection: socket.socket) -> None:
        connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
        for line in connection.makefile("r", encoding="ascii", errors="replace"):
            connection.sendall(f"{self._answer(line.strip())}\n".encode())

    def _answer(self, asked: str) -> str:
        if asked == "stop":
            self._stop()
        answers = {"PolyscopeVersion": "URSoftware 5.15.0.0 (Jan 01 2024)", "get serial number": "20225500001", "stop": "Stopped"}
        answers |= {"is in remote control": "true", "running": f"Program running: {str(self._playing()).lower()}"}
        return answers.get(asked, f"could not understand: '{asked}'")


class ScriptPort(TcpServer):
    """``run`` is called for each program of ur_rtde that is sent here."""

    def __init__(self, run: Callable[[], object], host: str, port: int = 30003) -> None:
        super().__init__(host, port, one=False)
        self._run = run

    def talk(self, connection: socket.socket) -> None:
        text = b""
        while data := connection.recv(65536):
            text += data
            if text.startswith(b"def rtde_control():") and text.endswith(b"\nend\n"):
                self._run()
                text = b""
