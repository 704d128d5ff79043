"""The fake EKI controller's process: two interpreters, an arm, a channel, and the clock that drives them. Started by server."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.controller_child import KukaController, serve
from mbcacq_fakes.protocols.krc.eki_channel import EkiChannel
from mbcacq_fakes.protocols.krc.eki_config import read_config
from mbcacq_fakes.protocols.krc.eki_functions import EkiFunctions
from mbcacq_fakes.protocols.krc.eki_outlet import Outlet
from mbcacq_fakes.protocols.krc.eki_settings import FAULTS, EkiSettings
from mbcacq_fakes.protocols.krc.eki_system import TICK_S, System, built_in
from mbcacq_fakes.protocols.krc.krl import Interpreter, Program

_SUBMIT_TICKS = 3  # 12 ms
_AHEAD_MS = 240  # fast: the robot's clock may run so far ahead of the client's last sign of life
_BEAT_WAIT_S = 0.25  # fast: or so long without one
_IDLE_S = 1.0  # fast: after standing so long the clock is everybody's
_SOFT_LIMIT, _OPERATOR = 5, 1  # indices into arm_state.FAULTS


class EkiController(KukaController):
    """``tick`` is 4 ms of the robot's time."""

    def __init__(self, settings: EkiSettings, state: ArmState | None = None) -> None:
        super().__init__(FAULTS, settings.faults)
        self.settings, self._state = settings, state
        self.system = System(settings)
        if state is not None:
            self.system.out.changed = state.switch
        config = read_config(settings.channel)
        self.channel = EkiChannel(settings.program, config, settings.host, settings.port, self._set_flag, Outlet(self.faults).send)
        self.port = self.channel.port
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
        if self.led is not None:
            self.system.machine.lead(self.led)
            self.led = None
        if self._robot is not None and self.system.pro_act:
            self._robot.tick(self.seconds)
            if self._robot.halted:
                self.system.pro_act = False
        elif not self.system.pro_act and not self.system.machine.led:
            self.system.machine.brake()
        moved = self.system.machine.tick()
        self._still_s = 0.0 if moved else self._still_s + TICK_S
        if not self._ticks % _SUBMIT_TICKS:
            if not self.faults.get("deaf"):
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
        faults, system = self.faults, self.system
        self.channel.refusing = bool(faults.get("refuse"))
        system.out.stuck = bool(faults.get("stuck"))
        system.machine.ignore, system.machine.short_deg = bool(faults.get("ignore")), faults.get("short_deg") or 0.0
        if override := faults.get("override"):
            system.ov_pro = int(override)
        if mode := faults.get("mode"):
            system.set_mode(int(mode))
        if load_kg := faults.get("load_kg"):
            system.load.m = load_kg
        if tool := faults.get("tool"):
            self.program.globals.mb_act_tool = int(tool) - 1
        if faults.use("reset"):
            self.channel.drop()
        stop = bool(faults.get("emergency_stop"))
        if stop or faults.use("program_stop"):
            system.pro_act, system.stopmess = False, True
            system.machine.brake()
        if stop == system.alarm_stop:
            system.alarm_stop = system.peri_rdy = not stop
        if not stop and faults.use("restart"):
            self._start_program()

    def _publish(self) -> None:
        assert self._state is not None  # tick looked
        arm = self.system.machine.arm
        q, qd = self.system.machine.radians()
        fault = 0 if self.system.pro_act or self._robot is None else _SOFT_LIMIT if self.system.machine.message else _OPERATOR
        self._state.write(self.seconds, tuple(q), tuple(qd), tuple(self.system.machine.directions()), arm.standstill, arm.arrivals, fault)

    def run(self, gone: threading.Event) -> None:
        due = time.monotonic()
        while not gone.is_set():
            self.tick()
            due = max(due + TICK_S, time.monotonic() - 0.05)
            if self.settings.realtime or self.idle:
                time.sleep(max(0.0, due - time.monotonic()))
                continue
            due = time.monotonic()
            deadline = due + _BEAT_WAIT_S
            while self.ahead_ms() > _AHEAD_MS and time.monotonic() < deadline and not gone.is_set():
                time.sleep(0.0002)
                self.channel.poll()
                if self.heard or self.channel.client is None:
                    break

    def close(self) -> None:
        self.channel.close()


if __name__ == "__main__":
    sys.exit(serve(lambda settings, state: EkiController(EkiSettings(**settings), state)))
