"""The fake EKI controller's process: two interpreters, an arm, a channel, and the clock that drives them. Started by eki_server.

One JSON line on standard input is a command ({"faults": {...}} or {"ask": true}), one line on standard output its answer.
"""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
import time
from typing import Any

from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.eki_channel import EkiChannel
from mbcacq_fakes.protocols.krc.eki_config import read_config
from mbcacq_fakes.protocols.krc.eki_functions import EkiFunctions
from mbcacq_fakes.protocols.krc.eki_outlet import Outlet
from mbcacq_fakes.protocols.krc.eki_settings import EkiSettings
from mbcacq_fakes.protocols.krc.eki_system import TICK_S, System, built_in
from mbcacq_fakes.protocols.krc.krl import Interpreter, KrlError, Program

_SUBMIT_TICKS = 3  # 12 ms
_AHEAD_MS = 240  # fast: the robot's clock may run so far ahead of the client's last sign of life
_BEAT_WAIT_S = 0.25  # fast: or so long without one
_IDLE_S = 1.0  # fast: after standing so long the clock is everybody's
_SOFT_LIMIT, _OPERATOR = 5, 1  # indices into arm_state.FAULTS


class EkiController:
    """``tick`` is 4 ms of the robot's time."""

    def __init__(self, settings: EkiSettings, state: ArmState | None = None) -> None:
        self.settings, self._state = settings, state
        self.system = System(settings)
        if state is not None:
            self.system.out.changed = state.switch
        self.outlet = Outlet(settings.faults)
        config = read_config(settings.channel)
        self.channel = EkiChannel(settings.program, config, settings.host, settings.port, self._set_flag, self.outlet.send)
        functions = EkiFunctions(self.channel).table() | built_in(self.system, settings)
        self.program = Program(settings.sources, self.system, functions)
        self._submit_init = Interpreter(self.program, f"{settings.link}_init")
        self._submit_init.tick(0.0)
        self._robot: Interpreter | None = None
        self._ticks, self._still_s, self._alone_ms = 0, 0.0, 0
        self.seconds = settings.clock_ms * 1e-3
        if settings.running:
            self._start_program()

    def tick(self) -> None:
        self._ticks += 1
        self.seconds += TICK_S
        self.system.rob_timer = self.settings.clock_ms + 4 * self._ticks
        if not self.program.globals.mb_linked:
            self._alone_ms = self.system.rob_timer
        self._apply_faults()
        if self._robot is not None and self.system.pro_act:
            self._robot.tick(self.seconds)
            if self._robot.halted:
                self.system.pro_act = False
        elif not self.system.pro_act and not self.system.machine.led:
            self.system.machine.brake()
        moved = self.system.machine.tick()
        self._still_s = 0.0 if moved else self._still_s + TICK_S
        if not self._ticks % _SUBMIT_TICKS:
            if not self.outlet.active["deaf"]:
                self.channel.poll()
            Interpreter(self.program, f"{self.settings.link}_step").tick(self.seconds)
        if self._state is not None and (moved or not self._ticks % 25 or self._still_s < 0.1):
            self._publish()

    def ahead_ms(self) -> float:
        """How far the clock is ahead of the client's last sign of life, of which its connection is the first; 0 without a client."""
        return self.system.rob_timer - max(self.program.globals.mb_beat, self._alone_ms) if self.program.globals.mb_linked else 0.0

    @property
    def heard(self) -> bool:
        """A telegram has come that the link program has not read yet."""
        return any(self.system.flag[number] for number in self.channel.config.flags.values())

    @property
    def idle(self) -> bool:
        return self._still_s > _IDLE_S or not self.program.globals.mb_linked

    def report(self) -> dict[str, Any]:
        """What a test may ask: the program's variables and the channel's counts."""
        known = {k: v for k, v in vars(self.program.globals).items() if isinstance(v, int | float | bool)}
        return {
            **known,
            "opened": self.channel.opened,
            "overflowed": self.channel.overflowed,
            "received": self.channel.received,
            "message": self.system.machine.message,
            "running": self.system.pro_act,
            "time_ms": self.system.rob_timer,
            "moving": self.system.machine.moving,
            "port": self.channel.port,
        }

    def _set_flag(self, number: int, value: bool) -> None:
        self.system.flag[number] = value

    def _start_program(self) -> None:
        self.system.machine.abandon()
        self._robot = Interpreter(self.program, self.settings.program, self.system.machine)
        self.system.pro_act, self.system.stopmess, self.system.machine.message = True, False, ""

    def _apply_faults(self) -> None:
        active, system = self.outlet.active, self.system
        self.channel.refusing = bool(active["refuse"])
        system.out.stuck = bool(active["stuck"])
        system.machine.ignore, system.machine.short_deg = bool(active["ignore"]), active["short_deg"]
        if active["override"]:
            system.ov_pro = int(active["override"])
        if active["mode"]:
            system.set_mode(int(active["mode"]))
        if active["load_kg"]:
            system.load.m = active["load_kg"]
        if active["tool"]:
            self.program.globals.mb_act_tool = int(active["tool"]) - 1
        if self.outlet.use("reset"):
            self.channel.drop()
        stop = bool(active["emergency_stop"])
        if stop or self.outlet.use("program_stop"):
            system.pro_act, system.stopmess = False, True
            system.machine.brake()
        if stop == system.alarm_stop:
            system.alarm_stop = system.peri_rdy = not stop
        if not stop and self.outlet.use("restart"):
            self._start_program()

    def _publish(self) -> None:
        assert self._state is not None  # tick looked
        arm = self.system.machine.arm
        q, qd = self.system.machine.radians()
        fault = 0 if self.system.pro_act or self._robot is None else _SOFT_LIMIT if self.system.machine.message else _OPERATOR
        self._state.write(self.seconds, tuple(q), tuple(qd), tuple(arm.direction), arm.standstill, arm.arrivals, fault)


def run(controller: EkiController, commands: queue.SimpleQueue, gone: threading.Event) -> None:
    """Until the parent is gone."""
    due = time.monotonic()
    while not gone.is_set():
        while not commands.empty():
            _obey(controller, commands.get())
        controller.tick()
        due = max(due + TICK_S, time.monotonic() - 0.05)
        if controller.settings.realtime or controller.idle:
            time.sleep(max(0.0, due - time.monotonic()))
            continue
        due = time.monotonic()
        deadline = due + _BEAT_WAIT_S
        while controller.ahead_ms() > _AHEAD_MS and time.monotonic() < deadline and commands.empty():
            time.sleep(0.0002)
            controller.channel.poll()
            if controller.heard or controller.channel.client is None:
                break


def _obey(controller: EkiController, command: dict[str, Any]) -> None:
    if "faults" in command:
        controller.outlet.inject(command["faults"])
    if "lead" in command:
        controller.system.machine.lead(command["lead"])
    print(json.dumps(controller.report()), flush=True)


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not (line := sys.stdin.readline()):
        return 0  # whoever started this was interrupted
    start = json.loads(line)
    state = ArmState.attach(start["state"])
    try:
        controller = EkiController(EkiSettings(**start["settings"]), state)
    except (KrlError, ValueError, OSError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 1
    print(json.dumps({"port": controller.channel.port}), flush=True)
    commands: queue.SimpleQueue = queue.SimpleQueue()
    gone = threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            commands.put(json.loads(line))
        gone.set()

    threading.Thread(target=listen, daemon=True).start()
    try:
        run(controller, commands, gone)
    finally:
        controller.channel.close()
        state.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
