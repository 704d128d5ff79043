"""One RSI session: which answer each telegram gets, and what ends the motion. No sockets, no clock of its own.

Corrections are absolute: offset of every axis (deg) from its position at RSI_ON, which is the first AIPos received. They
advance by one set point an answered telegram, never by elapsed time, so that no delay anywhere can make the arm jump. The first
fault is kept; it brakes the arm, and where the controller may have begun a new session nothing is answered any more.

The answer to the next telegram is rendered while the controller waits for nothing: ``reply`` only compares bytes with what is
expected and hands it out; everything else, which is parsing, watching, recording and planning, is done by ``digest`` after it was
sent. So a command takes effect one cycle later than it could; a telegram that is not the expected one is parsed first.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from mbcacq_kuka.rsi.arrival import Arrival
from mbcacq_kuka.rsi.handshake import WAITING_CYCLES, Handshake, Layout, SessionFault, set_point_moved
from mbcacq_kuka.rsi.lateness import Lateness
from mbcacq_kuka.rsi.motion import MotionRefused, RsiMotion
from mbcacq_kuka.rsi.sequence import NEXT, REPEATED, STRANGE, Counts, Sequence
from mbcacq_kuka.rsi.shared import ANSWERED, ARRIVED, CLOSE, MOVE, MOVING, STOP, Shared
from mbcacq_kuka.rsi.step_limits import StepLimits
from mbcacq_kuka.rsi.telegram import Composer, Malformed, finite
from mbcacq_kuka.rsi.watch import Follow, Jump

_STILL_DEG = 1e-3  # less motion in a cycle is standing still
_REST_CYCLES = 5  # standing still so long is being at rest
_END_CYCLES = 12  # and so long, before the session is ended
_STOP_CYCLES = 125
_CLOSE_S = 5.0
_HELD_S = 0.02  # without a new set point for so long the arm has all but stopped: the motion begins again from rest
_DELAY = re.compile(rb"<Delay[\s/>][^<]*")


@dataclass(frozen=True)
class Taken:
    """A telegram of the session: its numbers, how many cycles it is after the one before, whether the last answer was not used, and
    whether this one was answered while the controller waited."""

    row: list[float]
    steps: int = 1
    late: bool = False
    in_time: bool = True


class RsiSession:
    """``reply`` to every datagram, then ``digest`` it; ``idle`` when none came. Settings: see options.RsiOptions."""

    def __init__(self, shared: Shared, settings: dict[str, Any]) -> None:
        self._shared, self._settings = shared, settings
        self.silence_s = float(settings["silence_s"])
        self.cycle_s = settings["cycle_ms"] * 1e-3
        self._composer = Composer(settings["sen_type"], settings["correction"], settings["stop_element"])
        self.counts = Counts()
        self._handshake = Handshake(self._composer, settings, self.counts)
        self._layout: Layout | None = None
        self.over = False
        self._muted = self._closing = False
        self._seq = shared.command_seq
        self._arrival = Arrival()
        self.last_heard = self._close_began = 0.0
        self._stops = self._still = self._held = self._unanswered = 0
        self._rejected = False  # the last answer that was sent was not used, and is to be repeated
        self._ready: tuple[bytes, bytes, bytes] | None = None  # what the next telegram must contain (IPOC, Delay), and its answer
        self._data = b""  # the last telegram
        self._unparsed = False  # it was answered before it was parsed
        self._taken: Taken | None = None

    @property
    def connected(self) -> bool:
        return self._layout is not None

    @property
    def controller(self) -> Any:
        """Address of the sender, as soon as it is known; None before."""
        return None if self._handshake.layout is None else self._handshake.layout.source

    # what the cycle calls

    def reply(self, data: bytes, source: Any, now: float, in_time: bool = True) -> bytes | None:
        """The answer to a datagram, or None. ``in_time``: False for one that is answered too late in any case."""
        ready = self._ready
        if ready is not None and in_time and ready[0] in data and ready[1] in data and source == self.controller:
            self._ready, self._data, self._unparsed, self.last_heard = None, data, True, now
            return ready[2]
        if self._muted or self.over:
            return None
        try:
            return self._reply_slowly(data, source, now, in_time)
        except SessionFault as fault:
            self._fail(fault)
            return None

    def digest(self, now: float) -> None:
        """After the answer was sent: record and judge the telegram, and render the next answer."""
        if not self._unparsed and self._taken is None:
            return
        try:
            if self._unparsed:
                self._taken = self._parse_answered()
            if self._taken is not None:
                self._judge(self._taken, now)
        except SessionFault as fault:
            self._fail(fault)
        self._unparsed, self._taken = False, None
        self._prepare(now)

    def idle(self, now: float) -> None:
        """No telegram for a while."""
        if self.connected and not self._muted and now - self.last_heard > self.silence_s:
            self._fail(SessionFault("silence", f"the controller sent no telegram for {now - self.last_heard:.2f} s", muted=True))
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

    # telegrams that are not just the next one

    def _reply_slowly(self, data: bytes, source: Any, now: float, in_time: bool) -> bytes | None:
        layout = self._layout
        if layout is None:
            answer = self._handshake.take(data, source, now)
            if self.controller == source:
                self.last_heard = now
            if self._handshake.done is not None:
                self._data = data
                self._begin(self._handshake.done)
            return answer
        if source != layout.source:
            self.counts.foreign += 1
            return None
        silent, self.last_heard = now - self.last_heard, now
        try:
            digits, row = layout.parser.parse(data)
        except Malformed as error:
            raise SessionFault("protocol", f"the controller sent a malformed telegram: {error}") from error
        if not finite(layout.axes(row)):
            raise SessionFault("protocol", "a telegram came without AIPos")
        before, self._data = self._sequence.ipoc, data
        kind, steps = self._sequence.take(int(digits))
        if kind == STRANGE:
            raise SessionFault(
                "restart",
                f"IPOC went from {before} to {digits.decode()}, expected steps of {self._sequence.step}; was the RSI program restarted?",
                muted=True,
            )
        if kind == REPEATED and silent > WAITING_CYCLES * self.cycle_s:  # a peer that waits for its answer before it goes on
            return self._compose(digits, self._sent)
        return self._reply_next(layout, digits, row, steps, in_time) if kind == NEXT else None

    def _reply_next(self, layout: Layout, digits: bytes, row: list[float], steps: int, in_time: bool) -> bytes:
        if steps > 1 and set_point_moved(layout, row):
            raise SessionFault("restart", "ASPos has changed, so the RSI program was restarted during the run", muted=True)
        self._unanswered += steps - 1
        rise = 0.0 if layout.delay is None else self._lateness.rise(row[layout.delay], self._sequence.ipoc * layout.tick_s)
        self._rejected = self._rejected or rise > self._unanswered
        late = self._rejected or not in_time
        if in_time:
            self._rejected = False  # it is repeated now
        self._unanswered = 0 if in_time else self._unanswered + 1
        self._held += steps - 1 + late
        if not late:  # else the last answer was not used: repeat it
            if self._held * self.cycle_s > _HELD_S:
                self._resume()
            self._advance()
        self._taken = Taken(row, steps, late, in_time)
        if self._lateness.too_many:
            self._fail(
                SessionFault(
                    "late",
                    f"the controller discarded {self._lateness.count:.0f} answers as late or invalid (Delay; late_limit is "
                    f"{self._settings['late_limit']}); check the network, the load of this computer and sen_type",
                )
            )
        return self._compose(digits, self._sent, self._stop)

    def _begin(self, layout: Layout) -> None:
        settings = self._settings
        digits, row = layout.parser.parse(self._data)
        window = max(1, round(settings["ride_out_s"] / self.cycle_s))
        self._sequence = Sequence(int(digits), layout.step, window, self.counts)
        self._lateness = Lateness(0.0 if layout.delay is None else row[layout.delay], settings["late_limit"], settings["late_window_s"])
        joint_limits = [tuple(pair) for pair in settings["limits_deg"]]
        self._motion = RsiMotion(layout.reference, self.cycle_s, joint_limits)
        self._step_limits = StepLimits(layout.reference, joint_limits, settings["dynamics"], self.cycle_s)
        self._follow = Follow(
            layout.reference, settings["follow_tolerance_deg"], settings["follow_cycles"], settings["follow_lag_s"], self.cycle_s
        )
        self._previous = layout.axes(row)
        self._jump = Jump(self._previous, settings["dynamics"][0], self.cycle_s)
        self._sent = self._next = layout.reference
        self._sent_moving = self._next_moving = self._stop = self._faulted = False
        self._consumed = self._delivered = self._target_used = True
        self._command = self._seq
        self._shared.begin(layout.parser.names)
        self._layout, self._taken = layout, Taken(row)

    # the running session

    def _parse_answered(self) -> Taken:
        layout = self._layout
        assert layout is not None  # nothing is rendered in advance before the session has begun
        self._sequence.take(self._sequence.ipoc + self._sequence.step)
        self._unanswered = 0
        self._advance()
        try:
            _, row = layout.parser.parse(self._data)
        except Malformed as error:
            raise SessionFault("protocol", f"the controller sent a malformed telegram: {error}") from error
        if not finite(layout.axes(row)):
            raise SessionFault("protocol", "a telegram came without AIPos")
        return Taken(row)

    def _advance(self) -> None:
        """The prepared set point goes to the controller."""
        self._sent, self._sent_moving, self._consumed, self._held = self._next, self._next_moving, True, 0

    def _resume(self) -> None:
        try:
            self._motion.resume(self._sent)
        except MotionRefused as error:
            self._fail(SessionFault("refused", str(error)))
        self._step_limits.rest(self._sent)
        self._step()

    def _step(self) -> None:
        """The next set point, once it was seen to be within the axes' limits; one that is not is replaced by braking."""
        position = self._motion.step()
        if refusal := self._step_limits.refusal(position):
            self._motion.brake_instead(self._step_limits.dynamics)
            position = self._motion.step()
            still = self._step_limits.refusal(position)
            self._fail(SessionFault("refused", f"{refusal}; that set point was not sent", muted=bool(still)))
            if still:  # nothing is sent any more, the controller stops the arm
                return
        self._step_limits.take(position)
        self._next, self._next_moving = position, self._motion.moving

    def _prepare(self, now: float) -> None:
        """Everything about the next answer, so that it only waits for its telegram."""
        layout = self._layout
        if layout is None or self._muted or self.over:
            self._ready = None
            return
        self._poll_command(now)
        if self._consumed:
            self._consumed = False
            self._step()
            if self._muted:
                return
        self._stop = self._closing and self._ending(now)
        delay = b""
        if layout.delay is not None:
            found = _DELAY.search(self._data)
            delay = found[0] if found else b"?"
        digits = b"%d" % (self._sequence.ipoc + self._sequence.step)
        self._ready = (b"<IPOC>" + digits + b"</IPOC>", delay, self._compose(digits, self._next, self._stop))

    def _judge(self, taken: Taken, now: float) -> None:
        layout = self._layout
        assert layout is not None  # as above
        measured, time_s = layout.axes(taken.row), self._sequence.ipoc * layout.tick_s
        still = all(abs(a - b) < _STILL_DEG for a, b in zip(measured, self._previous, strict=True))
        self._previous = measured
        self._still = self._still + 1 if still and not self._sent_moving else 0
        self._delivered = not self._sent_moving and (self._delivered or self._target_used and not taken.late)
        self._target_used = not self._sent_moving
        coarse = self._arrival.judge(measured, self._still, time_s) if self._delivered else None
        flags = 0 if self._still >= _REST_CYCLES else MOVING
        flags |= (ARRIVED if self._arrival.arrived else 0) | (ANSWERED if taken.in_time else 0)
        self._shared.append(now, time_s, flags, self._command, self.counts, self._sent, taken.row)
        self._command = self._seq
        if coarse:
            raise SessionFault("coarse", coarse)
        self._check_plausible(measured, taken.steps)

    def _check_plausible(self, measured: tuple[float, ...], steps: int) -> None:
        jumped = self._jump.check(measured, steps)
        if jumped is not None:
            raise SessionFault(
                "implausible",
                f"the controller reports that A{jumped[0] + 1} jumped by {jumped[1]:.2f} deg within {steps * self.cycle_s * 1e3:.0f} ms, "
                "faster than it can turn; look at the arm, its resolvers and the RSI Ethernet configuration",
            )
        if steps > 1:
            self._follow.skip(measured, steps - 1)
        axis = self._follow.check(self._sent, measured)
        if axis is not None:
            raise SessionFault(
                "follow",
                f"A{axis + 1} does not follow: commanded {self._sent[axis]:.3f} deg, measured {measured[axis]:.3f} deg; "
                "look for a correction limit of the controller (AXISCORR, AXISCORRMON) or a stopped program",
            )

    def _compose(self, digits: bytes, position: tuple[float, ...], stop: bool = False) -> bytes:
        assert self._layout is not None  # as above
        correction = tuple([p - r for p, r in zip(position, self._layout.reference, strict=True)])
        return self._composer.compose(correction, digits, stop)

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
            self._arrival.abandon()
        elif command.kind == MOVE:
            self._arrival.begin(command)
            self._delivered = self._target_used = False
            if refusal := self._step_limits.too_fast(command):
                self._fail(SessionFault("refused", refusal))
                return
            try:
                self._motion.move(command)
            except MotionRefused as error:
                self._fail(SessionFault("refused", str(error)))

    def _ending(self, now: float) -> bool:
        """While closing: True once the arm stands and the controller may end the session."""
        standing = self._still >= _END_CYCLES or now - self._close_began > _CLOSE_S
        if standing:
            self._stops += 1
            self.over = not self._settings["stop_at_close"] or self._stops > _STOP_CYCLES
        return standing and bool(self._settings["stop_at_close"])

    def _fail(self, fault: SessionFault) -> None:
        """The first fault is kept; it brakes the arm."""
        self._shared.fail(fault.kind, str(fault))
        self._arrival.abandon()
        if fault.muted:
            self._muted, self._ready = True, None
        if self.connected and not self._faulted:
            self._faulted = True
            self._motion.stop()
