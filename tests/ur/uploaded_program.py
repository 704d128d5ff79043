"""A UR controller that takes programs: the ports on which clients upload them, and the program of ``ur_rtde``'s control interface.

Numbers of commands and registers as ``ur_rtde`` 1.6 sends and reads them.
"""

from __future__ import annotations

import logging
import math
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Self

import numpy as np
import ruckig
from mbcacq_fakes.dynamics.ideal_arm import Kinematics
from mbcacq_fakes.protocols.rtde import FakeUrController
from mbcacq_fakes.protocols.rtde.arm import BRAKE, JERK, ProgrammedArm
from mbcacq_fakes.protocols.rtde.controller import CLOCK_START_S, UR10E
from mbcacq_fakes.protocols.tcp_server import TcpServer
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

READY, DONE = 1, 2  # of output_int_register_0
RUNNING = 1 << 15  # of output_int_register_2: what was begun asynchronously goes on; its number stands in bits 24 to 30
STOPS = (15, 16, 33, 34)  # of speed, servo, a line, joints
LINE_POINTS = 33
_log = logging.getLogger("fake_ur")


class AlongPath:
    """A motion as of ruckig, along a path through joint angles q (k, 6) at lengths (k,)."""

    def __init__(self, length: np.ndarray, q: np.ndarray, speed: float, acceleration: float) -> None:
        wanted, self._along, self._path = ruckig.InputParameter(1), ruckig.Trajectory(1), CubicSpline(length, q)
        wanted.target_position, wanted.max_velocity, wanted.max_acceleration = [float(length[-1])], [speed], [acceleration]
        wanted.max_jerk = [JERK]
        ruckig.Ruckig(1).calculate(wanted, self._along)
        self.duration = self._along.duration

    def at_time(self, seconds: float) -> tuple[np.ndarray, np.ndarray, None]:
        (at,), (speed,), _ = self._along.at_time(seconds)
        return self._path(at), speed * self._path(at, 1), None


class LineArm(ProgrammedArm):
    """An arm that knows where its flange is, and moves it along lines."""

    def __init__(self, start_deg: Sequence[float]) -> None:
        self._kinematics = Kinematics(UR10E)
        super().__init__(start_deg, None, CLOCK_START_S)

    def flange_pose(self, q: np.ndarray) -> list[float]:
        """x, y, z (m) and rotation vector (rad) of the flange, q (6,) rad."""
        x, y, z, *abc = self._kinematics.pose(np.degrees(q).tolist())
        return [1e-3 * x, 1e-3 * y, 1e-3 * z, *Rotation.from_euler("ZYX", abc, degrees=True).as_rotvec().tolist()]

    def joints_at(self, pose: np.ndarray, near: np.ndarray) -> np.ndarray:
        """(6,) rad: joint angles near ``near`` at a pose as of ``flange_pose``. Raises ValueError where the arm does not reach it."""
        wanted = Rotation.from_rotvec(pose[3:]).inv()

        def off(q: np.ndarray) -> np.ndarray:
            here = np.array(self.flange_pose(q))
            return np.r_[here[:3] - pose[:3], (wanted * Rotation.from_rotvec(here[3:])).as_rotvec()]

        found = least_squares(off, near, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(found.fun).max() > 1e-6:
            raise ValueError("no joint angles bring the flange to this pose")
        return found.x

    def line(self, pose: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (k,) m along a straight line from here to a pose, and joint angles (k, 6) rad there. Raises ValueError."""
        begin, end = np.array(self.flange_pose(self.q)), np.array(pose, dtype=float)
        share = np.linspace(0, 1, LINE_POINTS)
        turn = Slerp([0, 1], Rotation.from_rotvec([begin[3:], end[3:]]))(share).as_rotvec()
        q = [self.q]
        for one, rotation in zip(share[1:], turn[1:], strict=True):
            q.append(self.joints_at(np.r_[begin[:3] + one * (end[:3] - begin[:3]), rotation], q[-1]))
        return share * max(float(np.linalg.norm(end[:3] - begin[:3])), 1e-6), np.array(q)

    def go_along(self, length: np.ndarray, q: np.ndarray, speed: float, acceleration: float) -> None:
        """Begin a motion through joint angles q (k, 6) rad at lengths (k,) of a path, with speed and acceleration along it."""
        self._motion, self._since, self.still_s = AlongPath(length, q, speed, acceleration), 0.0, 0.0
        self.target = q[-1].copy()


class UploadedProgram:
    """moveJ, moveL and their kin, stops, payload, forward and inverse kinematics; any other command ends it, with a sentence in the log."""

    def __init__(self, arm: LineArm, end: Callable[[], object], take_payload: Callable[[float], object]) -> None:
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


class ProgrammableUr(FakeUrController):
    """No program runs at first. At a host of its own, as clients know one number of each port only."""

    def __init__(self, host: str, start_deg: Sequence[float]) -> None:
        super().__init__(start_deg=start_deg, host=host, port=30004, realtime=True, runtime_state=1, watchdog_s=math.inf)
        self.arm: LineArm = LineArm(start_deg)
        self._host, self._program, self._ports = host, None, ExitStack()

    def __enter__(self) -> Self:
        self._ports.enter_context(Dashboard(self.playing, self.end_program, self._host))
        self._ports.enter_context(ScriptPort(self.run_uploaded, self._host))
        return super().__enter__()

    def stop(self) -> None:
        self._ports.close()
        super().stop()

    def playing(self) -> bool:
        return self._program is not None

    def run_uploaded(self) -> None:
        with self.lock:
            self._program = UploadedProgram(self.arm, self.end_program, lambda kg: self.inject(payload=kg))
            self.inject(runtime_state=2)

    def end_program(self) -> None:
        """The arm halts."""
        self._program = None
        self.inject(runtime_state=1)

    def obey(self, written: Mapping[str, Any]) -> None:
        self.inputs |= written
        if self._program is not None and "input_int_register_0" in written:
            self._program.obey(self.inputs)

    def values(self) -> dict[str, Any]:
        own = {} if self._program is None else self._program.registers()
        return {**super().values(), "robot_status_bits": 1 | self.playing() << 1, **own}
