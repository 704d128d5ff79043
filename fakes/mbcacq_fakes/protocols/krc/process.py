"""The fake controller's process: the cycle, its pacing and its faults. Started by server.FakeKrc with settings on standard input."""

from __future__ import annotations

import gc
import json
import os
import random
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from math import radians

from mbcacq_fakes.dynamics.ideal_arm import IdealArm, Kinematics
from mbcacq_fakes.protocols.idle import idle_s
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.control import Control
from mbcacq_fakes.protocols.krc.encoders import Encoders
from mbcacq_fakes.protocols.krc.session import OPERATOR, PC_STOP, FakeRsiSession
from mbcacq_fakes.protocols.krc.settings import COUNTED, JUMP_DEG, KrcSettings
from mbcacq_fakes.protocols.krc.wire import RobTemplate, RsiAnswer, SenReader

_TURN = 1 << 32  # the counter has 32 bits
_LONGEST_S = 0.05  # of one wait for an answer: whoever started this may be gone
_STALE_MS = 2000  # an answer to a telegram of so long ago is just late


def _zero() -> Sequence[float]:
    return (0.0,) * 6


class RsiController:
    """``cycle`` is one sensor cycle: move the arm, send, wait for the answer, count."""

    def __init__(
        self, settings: KrcSettings, state: ArmState, control: Control, sock: socket.socket, foreign: socket.socket, gone: threading.Event
    ) -> None:
        self._settings, self._state, self._control, self._socket, self._foreign = settings, state, control, sock, foreign
        self._gone = gone
        self._cycle_s = settings.cycle_ms * 1e-3
        self._arm = _arm(settings, self._cycle_s)
        self._encoders = Encoders(settings.encoder_noise_deg, settings.encoder_step_deg, settings.seed)
        self._kinematics = Kinematics(settings.dh)
        self._reader = SenReader(settings.correction, settings.stop_element)
        self._random = random.Random(settings.seed)
        self._ipoc, self._cycles, self._sessions, self._answers, self._late, self._rejected = settings.ipoc, 0, 0, 0, 0, 0
        self._fault_seq, self._fault_code, self._down_until, self._next, self._missed = -1, 0, 0.0, time.monotonic(), 0
        self._client = tuple(settings.client)
        self._body: tuple[object, str] = (None, "")
        self._pose: tuple[list[float], Sequence[float]] = ([], ())
        self._sources = self._element_sources()
        self._outputs = dict.fromkeys(settings.digital_outputs, False)  # $OUT
        self._begin_session()

    def cycle(self) -> None:
        if self._control.fault_seq != self._fault_seq:
            self._read_faults()
        self._ipoc = (self._ipoc + self._settings.cycle_ms) % _TURN
        self._cycles += 1
        session, arm, faults = self._session, self._arm, self._faults
        if self._stopped_by_operator():
            session.ended = OPERATOR
        if session.ended is None:
            session.apply(faults["clamp_deg"] or self._settings.clamp_deg, faults["ignore"] != 0.0)
        if self._control.led_seq and session.start != (led := self._control.led()):
            session.lead(led)
            self._planned_pose = self._kinematics.pose(session.start)
        self._switch()
        moved = arm.step(session.set_point)
        if moved or not self._cycles % 25 or session.ended is not None:
            self._publish()
        if session.ended is not None:
            self._end_session()
        elif time.monotonic() < self._down_until:
            time.sleep(self._cycle_s)
        else:
            self._fault_code = 0
            self._exchange(moved)

    def _switch(self) -> None:
        """Carry out what the last answer says of the outputs; a session that ends, but for Stop, leaves them as they are until the program
        begins again."""
        if not self._outputs or self._faults["stuck"] or self._session.ended not in (None, PC_STOP) or time.monotonic() < self._down_until:
            return
        for number, value in self._session.outputs.items():
            if self._outputs[number] != value:
                self._outputs[number] = value
                self._state.switch(number, value)

    # one exchange

    def _exchange(self, moved: bool) -> None:
        faults, session = self._faults, self._session
        if self._settings.realtime:
            period = self._cycle_s * self._settings.stretch
            time.sleep(max(0.0, self._next - time.monotonic()))
            self._next = max(self._next, time.monotonic() - period) + period
        if faults["delay_ms"]:
            time.sleep(min(faults["delay_ms"] * 1e-3, self._cycle_s))
        ipoc = self._ipoc + (1 if self._counted("wrong_ipoc") else 0)
        sent = time.monotonic()
        on_its_way = not faults["silence"] and not self._lost("drop")
        if on_its_way:
            self._send(self._telegram(ipoc, moved))
        answer, latency = self._await(ipoc, sent, on_its_way)
        late = bool(faults["delay_ms"]) and faults["delay_ms"] >= self._settings.cycle_ms
        accepted = not late and not self._lost("drop_answers") and answer is not None and session.accept(answer, ipoc)
        if accepted:
            self._answers += 1
            self._missed = 0
        else:
            self._missed += 1
            self._rejected += answer is not None
            thrown_away = answer is not None and answer.ipoc == str(ipoc)  # in time, but of another SENTYPE
            self._late += session.active or thrown_away
            session.miss(thrown_away)
        if self._control.log_rows > 1:
            correction = [answer.correction.get(a, 0.0) for a in ("A1", "A2", "A3", "A4", "A5", "A6")] if answer else [0.0] * 6
            self._control.log(ipoc, latency, accepted, *self._arm.q, *correction)
        self._pace()

    def _await(self, ipoc: int, sent: float, on_its_way: bool) -> tuple[RsiAnswer | None, float]:
        """The first answer of this cycle that belongs to it, else the last one that came; and how long it took."""
        if self._settings.realtime:
            deadline = self._next
        elif on_its_way:
            deadline = sent + self._settings.answer_wait_s[self._unheard]
        else:
            deadline = sent + self._cycle_s
        wanted, answer, self._unheard = str(ipoc), None, True
        while (left := deadline - time.monotonic()) > 0 and not self._gone.is_set():
            self._socket.settimeout(min(left, _LONGEST_S))
            try:
                data = self._socket.recv(65536)
            except (TimeoutError, ConnectionError):
                continue
            arrived, self._unheard = time.monotonic(), False
            answer = self._reader.read(data)
            if answer is not None and answer.ipoc == wanted:
                return answer, arrived - sent
            stale = answer is not None and 0 < ipoc - int(answer.ipoc) <= _STALE_MS
            if not self._settings.realtime and not stale:
                break
        return answer, float("nan")

    def _pace(self) -> None:
        if self._settings.realtime:
            return
        if not self._session.active or self._missed:
            time.sleep(self._cycle_s)
            return
        if sleep_s := idle_s(self._arm.still_cycles * self._cycle_s):
            time.sleep(sleep_s)

    def _telegram(self, ipoc: int, moved: bool) -> bytes:
        if self._empty_sent < self._settings.empty_first:
            self._empty_sent += self._session.active
            return f'<Rob Type="KUKA"><IPOC>{ipoc}</IPOC></Rob>'.encode()
        if self._counted("malformed"):
            return f'<Rob Type="KUKA"><AIPos A1="1.0" A2=<IPOC>{ipoc}</IPOC></Rob>'.encode()
        if self._counted("no_aipos"):
            return f'<Rob Type="KUKA"><Delay D="{self._session.delay}"/><IPOC>{ipoc}</IPOC></Rob>'.encode()
        key = (self._session.delay, self._session.start, self._fault_seq, *self._outputs.values())
        if moved or self._encoders.noisy or self._body[0] != key:
            self._body = (key, self._template.body([v for e in self._template.elements for v in self._values(e)]))
        if self._counted("jump"):
            shown = [
                v + (JUMP_DEG if e == "AIPos" and not k else 0.0) for e in self._template.elements for k, v in enumerate(self._values(e))
            ]
            return self._template.finish(self._template.body(shown), ipoc)
        return self._template.finish(self._body[1], ipoc)

    def _values(self, element: str) -> Sequence[float]:
        return self._sources.get(element, _zero)()

    def _element_sources(self) -> dict[str, Callable[[], Sequence[float]]]:
        """Where the values of each element come from."""
        arm = self._arm
        return {
            "AIPos": lambda: self._encoders.read(arm.q, self._cycles),
            "ASPos": lambda: self._session.start,
            "RIst": self._actual_pose,
            "RSol": lambda: self._planned_pose,
            "MACur": arm.currents,
            "GearTorque": lambda: getattr(arm, "torque", _zero()),
            "AJPos": lambda: getattr(arm, "joint_deg", arm.q),
            "EIPos": lambda: self._settings.external_deg,
            "Delay": lambda: (self._session.delay,),
            "Digout": lambda: tuple(self._outputs.values()),
        }

    def _actual_pose(self) -> Sequence[float]:
        if self._pose[0] != self._arm.q:
            self._pose = (list(self._arm.q), self._kinematics.pose(self._arm.q))
        return self._pose[1]

    def _send(self, telegram: bytes) -> None:
        sender = self._foreign if self._counted("foreign") else self._socket
        try:
            sender.sendto(telegram, self._client)
        except OSError:
            pass  # nobody listens yet

    # sessions and faults

    def _begin_session(self) -> None:
        self._session = FakeRsiSession(self._settings, self._arm.q)
        self._planned_pose = self._kinematics.pose(self._arm.q)
        self._sessions += 1
        self._missed = self._empty_sent = 0
        self._unheard = True  # whoever had the session before may be gone

    def _end_session(self) -> None:
        """The set point stays where it is, so the arm comes to rest; then telegrams are offered again, as if the program was restarted."""
        self._fault_code = self._session.ended or 0
        if self._arm.standstill:
            self._publish()
            self._down_until = time.monotonic() + (self._settings.rearm_s if self._fault_code else 0.4)
            self._begin_session()
        else:
            time.sleep(self._cycle_s if self._settings.realtime else 0.0)

    def _stopped_by_operator(self) -> bool:
        if self._faults["stop"]:
            self._control.set_faults({"stop": 0.0})
            return True
        return False

    def _read_faults(self) -> None:
        self._fault_seq = self._control.fault_seq
        self._faults = self._control.faults()
        self._left = {name: int(self._faults[name]) for name in COUNTED if self._faults[name]}
        for name in self._left:
            self._control.set_faults({name: 0.0})
        self._fault_seq = self._control.fault_seq
        quirks = {name: self._faults[name] != 0.0 for name in ("upper_type", "swap")}
        self._template = RobTemplate(
            self._settings.elements, self._settings.precision, int(self._faults["spaced"]), outputs=self._settings.digital_outputs, **quirks
        )

    def _counted(self, name: str) -> bool:
        if not self._left or not self._left.get(name) or not self._session.active:
            return False
        self._left[name] -= 1
        return True

    def _lost(self, name: str) -> bool:
        return self._faults[name] > 0.0 and self._random.random() < self._faults[name]

    def _publish(self) -> None:
        arm, control = self._arm, self._control
        self._state.write(
            self._ipoc * 1e-3,
            tuple([radians(v) for v in arm.q]),
            tuple([radians(v) for v in arm.qd]),
            tuple(arm.direction),
            arm.standstill,
            arm.arrivals,
            self._fault_code,
        )
        if self._cycles % 25 and not arm.standstill:
            return
        for name, value in (
            ("cycles", self._cycles),
            ("sessions", self._sessions),
            ("answers", self._answers),
            ("late", self._late),
            ("rejected", self._rejected),
            ("active", self._session.active),
            ("ended", self._fault_code),
        ):
            control.count(name, value)


def _arm(settings: KrcSettings, cycle_s: float) -> IdealArm:
    if settings.moving is None:
        return IdealArm(settings.start_deg, cycle_s, settings.lag_s)
    from mbcacq_fakes.dynamics.online import MovingArm

    return MovingArm(settings.start_deg, cycle_s, settings.lag_s, settings.moving)


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not (line := sys.stdin.readline()):
        return 0  # whoever started this was interrupted
    start = json.loads(line)
    settings = KrcSettings(**start["settings"])
    gone = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), gone.set()), daemon=True).start()
    state, control = ArmState.attach(start["state"]), Control.attach(start["control"])
    gc.collect()
    gc.freeze()
    gc.disable()
    if settings.realtime:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
        except (AttributeError, OSError):
            pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        sock.bind((start["bind"], 0))
        controller = RsiController(settings, state, control, sock, foreign, gone)
        print(json.dumps({"ready": sock.getsockname()[1]}), flush=True)
        while not gone.is_set():
            controller.cycle()
    state.close()
    control.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
