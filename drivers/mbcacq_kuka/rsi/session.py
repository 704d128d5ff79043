"""One RSI session: which answer each telegram gets, and what ends the motion. No sockets, no clock of its own.

Corrections are absolute: offset of every axis (deg) from its position at RSI_ON, which is the first AIPos received. They
advance by one set point an answered telegram, never by elapsed time, so that no delay anywhere can make the arm jump. The first
fault is kept; it brakes the arm, and where the controller may have begun a new session nothing is answered any more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from mbcacq_kuka.rsi.arrival import Arrival
from mbcacq_kuka.rsi.motion import MotionRefused, RsiMotion
from mbcacq_kuka.rsi.shared import ANSWERED, ARRIVED, CLOSE, MOVE, MOVING, STOP, Shared
from mbcacq_kuka.rsi.telegram import Composer, Malformed, Parser, finite
from mbcacq_kuka.rsi.watch import Follow

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_LEARN = 5  # telegrams answered with zero before the session counts as connected
_PATIENCE = 5  # telegrams that are no use before we say so
_EMPTY = 50  # the same for those that are only empty: they queue up while we start
_STILL_DEG = 1e-3  # less motion in a cycle is standing still
_REST_CYCLES = 5  # standing still so long is being at rest
_END_CYCLES = 12  # and so long, before the session is ended
_STOP_CYCLES = 125
_CLOSE_S = 5.0


class RsiSession:
    """``answer`` for every datagram, ``idle`` when none came. Settings: see driver.Options."""

    def __init__(self, shared: Shared, settings: dict[str, Any]) -> None:
        self._shared, self._settings = shared, settings
        self.silence_s = float(settings["silence_s"])
        self.cycle_s = settings["cycle_ms"] * 1e-3
        self._composer = Composer(settings["sen_type"], settings["correction"], settings["stop_element"])
        self._late_limit = int(settings["late_limit"])
        self.connected = self.over = False
        self._muted = self._closing = False
        self._useless = 0
        self._controller: Any = None
        self._parser: Parser | None = None
        self._seq = shared.command_seq
        self._arrival = Arrival()
        self.last_heard = self._close_began = 0.0
        self._stops = self._still = 0

    # what the cycle calls

    def answer(self, data: bytes, source: Any, now: float, in_time: bool = True) -> bytes | None:
        """The answer to a datagram, or None. ``in_time``: False for one that is answered too late in any case."""
        if self._muted or self.over:
            return None
        if self._parser is None:
            return self._meet(data, source, now)
        if source != self._controller:
            self._fail(
                "protocol",
                f"a telegram came from {_text(source)} although the controller is {_text(self._controller)}; "
                "keep other senders off this port",
            )
            return None
        self.last_heard = now
        try:
            digits, row = self._parser.parse(data)
        except Malformed as error:
            self._fail("protocol", f"the controller sent a malformed telegram: {error}")
            return None
        measured = self._axes(row)
        if not finite(measured):
            self._fail("protocol", "a telegram came without AIPos")
            return None
        ipoc = int(digits)
        if not self.connected:
            return self._learn(ipoc, digits, row, measured, now)
        if ipoc == self._ipoc and self._repeats < self._late_limit:  # a doubled datagram: the same answer again
            self._repeats += 1
            return self._compose(digits)
        if not self._in_sequence(ipoc):
            return None
        return self._cycle(digits, row, measured, now, in_time)

    def idle(self, now: float) -> None:
        """No telegram for a while."""
        if self.connected and not self._muted and now - self.last_heard > self.silence_s:
            self._fail("silence", f"the controller sent no telegram for {now - self.last_heard:.2f} s")
            self._muted = True
        self._poll_command(now)
        quiet = now - max(self.last_heard, self._close_began)
        if self._closing and (not self.connected or self._muted or quiet > (0.06 if self._stops else 0.3)):
            self.over = True

    def close(self, now: float) -> None:
        """Brake; once the arm stands, end the session."""
        if not self._closing:
            self._closing, self._close_began = True, now
            if self.connected:
                self._motion.stop()
            self.over = self._muted or not self.connected

    # getting to know each other

    def _meet(self, data: bytes, source: Any, now: float) -> bytes | None:
        wanted = self._settings["controller_ip"]
        if wanted and source[0] != wanted:
            return self._no_use(f"telegrams come from {source[0]}, not from the controller at {wanted}")
        try:
            parser = Parser(data)
            digits, row = parser.parse(data)
        except Malformed as error:
            return self._no_use(f"datagrams arrive from {_text(source)}, but they are no RSI telegrams: {error}")
        slots = parser.slots("AIPos", AXES)
        if slots is None:  # RSI 2 may begin with a nearly empty telegram
            self._no_use("the telegrams carry no AIPos; add DEF_AIPos to the SEND section of the RSI Ethernet configuration", _EMPTY)
            return self._composer.compose((0.0,) * 6, digits)
        self._axes: Callable[[Sequence[float]], tuple[float, ...]] = itemgetter(*slots)
        start, delay, planned = self._axes(row), parser.slots("Delay", ("D",)), parser.slots("ASPos", AXES)
        if planned is not None and self._settings["check_set_point"]:
            apart = max(abs(row[i] - a) for i, a in zip(planned, start, strict=True))
            if apart > 0.1:
                self._fail(
                    "connect",
                    f"AIPos and ASPos differ by {apart:.2f} deg, so the controller still applies an earlier correction; "
                    "restart its RSI program (or set check_set_point: false if it does not report ASPos properly)",
                )
                self._muted = True
                return None
        self._delay_slot = delay[0] if delay else None
        self._delay = self._delay_base = row[self._delay_slot] if delay else 0.0
        self._reference = self._previous = start
        self._learned, self._controller, self._parser = [], source, parser
        self.last_heard = now
        return self._learn(int(digits), digits, row, start, now)

    def _no_use(self, reason: str, patience: int = _PATIENCE) -> None:
        self._useless += 1
        if self._useless >= patience:
            self._fail("protocol", reason)

    def _learn(self, ipoc: int, digits: bytes, row: list[float], measured: tuple[float, ...], now: float) -> bytes | None:
        """The first telegrams are answered with no correction while the step of IPOC shows itself."""
        if not self._learned or ipoc != self._learned[-1]:
            self._learned.append(ipoc)
        if len(self._learned) > _LEARN:
            cycle_ms = self._settings["cycle_ms"]
            steps = {b - a for a, b in zip(self._learned, self._learned[1:], strict=False)}
            if steps == {1}:  # simulators that count telegrams
                self._step, self._tick_s = 1, self.cycle_s
            elif min(steps) == cycle_ms and all(s % cycle_ms == 0 for s in steps):
                self._step, self._tick_s = cycle_ms, 1e-3
            else:
                self._fail(
                    "protocol",
                    f"IPOC advances by {min(steps)} a telegram, expected {cycle_ms}; set cycle_ms to 4 for #IPO_FAST, to 12 for #IPO",
                )
                self._muted = True
                return None
            self._begin(ipoc)
            return self._cycle(digits, row, measured, now, True)
        return self._composer.compose((0.0,) * 6, digits)

    def _begin(self, ipoc: int) -> None:
        limits = [tuple(pair) for pair in self._settings["limits_deg"]]
        self._ipoc, self._repeats, self._unanswered = ipoc, 0, 0
        self._motion = RsiMotion(self._reference, self.cycle_s, limits)
        self._follow = Follow(self._reference, self._settings["follow_tolerance_deg"], self._settings["follow_cycles"])
        self._shared.begin(self._parser.names)
        self.connected = True

    # the running session

    def _in_sequence(self, ipoc: int) -> bool:
        steps, rest = divmod(ipoc - self._ipoc, self._step)
        if rest or not 0 < steps <= max(self._late_limit, 1):
            self._fail("protocol", f"IPOC went from {self._ipoc} to {ipoc}, expected steps of {self._step}; was the RSI program restarted?")
            return False
        self._ipoc, self._repeats = ipoc, 0
        self._unanswered += steps - 1
        return True

    def _cycle(self, digits: bytes, row: list[float], measured: tuple[float, ...], now: float, in_time: bool) -> bytes | None:
        late = self._late(row) or not in_time
        self._unanswered = 0 if in_time else self._unanswered + 1
        if self._shared.command_seq != self._seq:
            self._poll_command(now)
        motion, time_s = self._motion, self._ipoc * self._tick_s
        position = motion.position if late else motion.step()  # the last answer was not used: repeat it
        axis = self._follow.check(position, measured)
        if axis is not None:
            self._fail(
                "follow",
                f"A{axis + 1} does not follow: commanded {position[axis]:.3f} deg, measured {measured[axis]:.3f} deg; "
                "look for a correction limit of the controller (AXISCORR, AXISCORRMON) or a stopped program",
            )
        still = all(abs(a - b) < _STILL_DEG for a, b in zip(measured, self._previous, strict=True))
        self._previous = measured
        self._still = self._still + 1 if still and not motion.moving else 0
        if not motion.moving and (too_coarse := self._arrival.judge(measured, self._still, time_s)):
            self._fail("coarse", too_coarse)
        flags = (0 if self._still >= _REST_CYCLES else MOVING) | (ARRIVED if self._arrival.arrived else 0) | (ANSWERED if in_time else 0)
        self._shared.append(now, time_s, flags, self._seq, position, row)
        return self._compose(digits, self._closing and self._ending(now))

    def _compose(self, digits: bytes, stop: bool = False) -> bytes:
        correction = tuple([p - r for p, r in zip(self._motion.position, self._reference, strict=True)])
        return self._composer.compose(correction, digits, stop)

    def _late(self, row: list[float]) -> bool:
        """True if the controller has rejected an answer of ours since the last telegram; those never sent do not count."""
        if self._delay_slot is None:
            return False
        delay = row[self._delay_slot]
        rise, self._delay = delay - self._delay, delay
        self._delay_base = min(self._delay_base, delay)
        if delay - self._delay_base > self._late_limit:
            self._fail(
                "late",
                f"the controller discarded {delay - self._delay_base:.0f} answers as late or invalid (Delay; late_limit is "
                f"{self._late_limit}); check the network, the load of this computer and sen_type",
            )
        return rise > self._unanswered

    def _poll_command(self, now: float) -> None:
        if self._shared.command_seq == self._seq:
            return
        self._seq, command = self._shared.receive()
        if command.kind == CLOSE:
            self.close(now)
        elif not self.connected or self._shared.fault() is not None or self._closing:
            return
        elif command.kind == STOP:
            self._motion.stop()
            self._arrival.leave()
        elif command.kind == MOVE:
            self._arrival.begin(command)
            try:
                self._motion.move(command)
            except MotionRefused as error:
                self._fail("refused", str(error))

    def _ending(self, now: float) -> bool:
        """While closing: True once the arm stands and the controller may be told to end the session."""
        standing = self._still >= _END_CYCLES or now - self._close_began > _CLOSE_S
        if standing:
            self._stops += 1
            self.over = not self._settings["stop_at_close"] or self._stops > _STOP_CYCLES
        return standing and bool(self._settings["stop_at_close"])

    def _fail(self, kind: str, text: str) -> None:
        self._shared.fail(kind, text)
        self._arrival.leave()
        if self.connected:
            self._motion.stop()


def _text(source: Any) -> str:
    return f"{source[0]}:{source[1]}"
