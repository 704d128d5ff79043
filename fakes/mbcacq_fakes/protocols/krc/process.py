"""The fake controller's process: the cycle, its pacing and its faults. Started by server.FakeKrc."""

from __future__ import annotations

import gc
import os
import random
import socket
import sys
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import radians
from typing import Any

from mbcacq_fakes.dynamics.ideal_arm import IdealArm, Kinematics
from mbcacq_fakes.protocols.idle import idle_s
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.controller_child import KukaController, serve
from mbcacq_fakes.protocols.krc.encoders import Encoders
from mbcacq_fakes.protocols.krc.session import AXES, OPERATOR, PC_STOP, FakeRsiSession
from mbcacq_fakes.protocols.krc.settings import FAULTS, JUMP_DEG, KrcSettings
from mbcacq_fakes.protocols.krc.wire import RobTemplate, RsiAnswer, SenReader

_TURN = 1 << 32  # the counter has 32 bits
_LONGEST_S = 0.05  # of one wait for an answer: whoever started this may be gone
_STALE_MS = 2000  # an answer to a telegram of so long ago is just late


def _zero() -> Sequence[float]:
    return (0.0,) * 6


class RsiController(KukaController):
    """``cycle`` is one sensor cycle: move the arm, send, wait for the answer, count."""

    def __init__(self, settings: KrcSettings, state: ArmState) -> None:
        super().__init__(FAULTS, settings.faults)
        self._settings, self._state, self._gone = settings, state, threading.Event()
        self._socket, self._foreign = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._socket.bind((settings.bind, 0))
        self.port = self._socket.getsockname()[1]
        self._log = array("d")
        self._cycle_s = settings.cycle_ms * 1e-3
        self._arm = _arm(settings, self._cycle_s)
        self._encoders = Encoders(settings.encoder_noise_deg, settings.encoder_step_deg, settings.seed)
        self._kinematics = Kinematics(settings.dh)
        self._reader = SenReader(settings.correction, settings.stop_element)
        self._random = random.Random(settings.seed)
        self._ipoc, self._cycles, self._sessions, self._answers, self._late, self._rejected = settings.ipoc, 0, 0, 0, 0, 0
        self._fault_code, self._down_until, self._next, self._missed = 0, 0.0, time.monotonic(), 0
        self._client = tuple(settings.client)
        self._body: tuple[object, str] = (None, "")
        self._pose: tuple[list[float], Sequence[float]] = ([], ())
        self._sources = self._element_sources()
        self._outputs = dict.fromkeys(settings.digital_outputs, False)  # $OUT
        self._written: tuple[float, ...] = (-1.0,)  # how a telegram is written
        self._begin_session()

    def cycle(self) -> None:
        self._choose_template()
        self._ipoc = (self._ipoc + self._settings.cycle_ms) % _TURN
        self._cycles += 1
        session, arm, faults = self._session, self._arm, self.faults
        if faults.use("stop"):
            session.ended = OPERATOR
        if session.ended is None:
            session.apply(faults.get("clamp_deg") or self._settings.clamp_deg, bool(faults.get("ignore")))
        if self.led is not None and session.start != self.led:
            session.lead(self.led)
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
        if (
            not self._outputs
            or self.faults.get("stuck")
            or self._session.ended not in (None, PC_STOP)
            or time.monotonic() < self._down_until
        ):
            return
        for number, value in self._session.outputs.items():
            if self._outputs[number] != value:
                self._outputs[number] = value
                self._state.switch(number, value)

    # one exchange

    def _exchange(self, moved: bool) -> None:
        faults, session = self.faults, self._session
        if self._settings.realtime:
            period = self._cycle_s * self._settings.stretch
            time.sleep(max(0.0, self._next - time.monotonic()))
            self._next = max(self._next, time.monotonic() - period) + period
        if delay_ms := faults.get("delay_ms") or 0.0:
            time.sleep(min(delay_ms * 1e-3, self._cycle_s))
        ipoc = self._ipoc + (1 if self._counted("wrong_ipoc") else 0)
        sent = time.monotonic()
        on_its_way = not faults.get("silence") and not self._lost("drop")
        if on_its_way:
            self._send(self._telegram(ipoc, moved))
        answer, latency = self._await(ipoc, sent, on_its_way)
        late = delay_ms >= self._settings.cycle_ms
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
        if self._settings.log:
            given = answer.correction if answer else dict.fromkeys(AXES, 0.0)
            correction = [given.get(axis, 0.0) for axis in AXES] if given else session.correction  # an answer without one has the last held
            self._log.extend((ipoc, latency, accepted, *self._arm.q, *correction))
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
        key = (self._session.delay, self._session.start, self._written, *self._technology(), *self._outputs.values())
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
            "Tech": self._technology,
            "Delay": lambda: (self._session.delay,),
            "Digout": lambda: tuple(self._outputs.values()),
        }

    def _technology(self) -> Sequence[float]:
        """Load, tool and base, as the program of mbcacq writes them to $TECHPAR_C[2,..]."""
        said = self.faults.get
        return (said("load_kg") or self._settings.load_kg, said("tool") or 1.0, said("base") or 0.0, *[0.0] * 7)

    def _actual_pose(self) -> Sequence[float]:
        if self._pose[0] != self._arm.q:
            self._pose = (list(self._arm.q), self._kinematics.pose(self._arm.q))
        return self._pose[1]

    def _send(self, telegram: bytes) -> None:
        sender = self._foreign if self._counted("foreign") else self._socket
        with suppress(OSError):  # nobody listens yet
            sender.sendto(telegram, self._client)

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

    def _choose_template(self) -> None:
        settings, written = self._settings, tuple(float(self.faults.get(name) or 0.0) for name in ("spaced", "upper_type", "swap"))
        if written == self._written:
            return
        self._written, (spaced, upper_type, swap) = written, written
        self._template = RobTemplate(
            settings.elements, settings.precision, int(spaced), bool(upper_type), bool(swap), settings.digital_outputs
        )

    def _counted(self, name: str) -> bool:
        return self._session.active and bool(self.faults.use(name))

    def _lost(self, name: str) -> bool:
        probability = self.faults.get(name)
        return bool(probability) and self._random.random() < probability

    def _publish(self) -> None:
        arm = self._arm
        self._state.write(
            self._ipoc * 1e-3,
            tuple([radians(v) for v in arm.q]),
            tuple([radians(v) for v in arm.qd]),
            tuple(arm.direction),
            arm.standstill,
            arm.arrivals,
            self._fault_code,
        )

    def report(self) -> dict[str, Any]:
        return {
            "cycles": self._cycles,
            "sessions": self._sessions,
            "answers": self._answers,
            "late": self._late,
            "rejected": self._rejected,
            "active": self._session.active,
            "ended": self._fault_code,
        }

    def log(self) -> bytes:
        return self._log.tobytes()

    def run(self, gone: threading.Event) -> None:
        self._gone = gone
        gc.collect()
        gc.freeze()
        gc.disable()
        if self._settings.realtime:
            with suppress(AttributeError, OSError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
        while not gone.is_set():
            self.cycle()

    def close(self) -> None:
        self._socket.close()
        self._foreign.close()


def _arm(settings: KrcSettings, cycle_s: float) -> IdealArm:
    if settings.moving is None:
        return IdealArm(settings.start_deg, cycle_s, settings.lag_s)
    from mbcacq_fakes.dynamics.online import MovingArm

    return MovingArm(settings.start_deg, cycle_s, settings.lag_s, settings.moving)


if __name__ == "__main__":
    sys.exit(serve(lambda settings, state: RsiController(KrcSettings(**settings), state)))
