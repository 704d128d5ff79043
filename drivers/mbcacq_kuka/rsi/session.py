"""One RSI session: which answer each telegram gets, and what ends the motion. No sockets, no clock of its own.

Corrections are absolute: offset of every axis (deg) from its position at RSI_ON, which is the first AIPos received. They advance by one set
point (see set_points) an answered telegram, never by elapsed time, so that no delay anywhere can make the arm jump. A late telegram (see
punctuality) is answered without a set point: no controller takes that answer, and a controller that hides the lateness in its Delay must
not fall behind the set points.

The first fault is kept. It brakes the arm, then ends the controller's session. The session is ended at once if the arm does not follow its
commands. Nothing is answered any more if the controller may have begun a new one. docs/explanation/corrections.md has the argument.

The answer to the next telegram is rendered while the controller waits for nothing: ``reply`` only compares bytes with the expected ones and
hands it out. ``digest`` does everything else after it was sent: parsing, watching, recording and planning. So a command takes effect one
cycle later than it could; a telegram that is not the expected one is parsed first.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

from mbcacq_kuka.rsi.arrival import Arrival, too_coarse
from mbcacq_kuka.rsi.handshake import WAITING_CYCLES, ZERO, Handshake, Layout, SessionFault, set_point_moved
from mbcacq_kuka.rsi.lateness import Lateness
from mbcacq_kuka.rsi.plausibility import ArmPlausibility
from mbcacq_kuka.rsi.punctuality import Punctuality
from mbcacq_kuka.rsi.sequence import NEXT, REPEATED, STRANGE, Counts, Sequence
from mbcacq_kuka.rsi.set_points import SetPoints
from mbcacq_kuka.rsi.shared import ANSWERED, ARRIVED, CLOSE, MOVE, MOVING, STOP, RsiCommand, Shared
from mbcacq_kuka.rsi.standstill import Standstill
from mbcacq_kuka.rsi.telegram import Composer, Malformed, finite

_REST_CYCLES = 5  # standing still so long is being at rest
_END_CYCLES = 12  # and so long, before the session is ended
_STOP_CYCLES = 50  # a rising edge is enough; some are lost, and a controller that ignores it ends by its own Timeout
_SETTLE_S = 0.5  # after the last set point a session is ended in any case
_AT_ONCE = ("follow", "relative")  # faults of an arm that does not do what it is told: no set point may move it any more
_DELAY = re.compile(rb"<Delay[\s/>][^<]*")


@dataclass(frozen=True)
class Taken:
    """A telegram of the session: its numbers, how many cycles it is after the one before, whether it was answered as soon as it came, and
    whether it came too late for that."""

    row: list[float]
    steps: int = 1
    in_time: bool = True
    held_up: bool = False


class RsiSession:
    """``reply`` to every datagram, then ``digest`` it; ``idle`` when none came, ``rehearse`` before one is ``due``. Settings: see
    options.RsiOptions."""

    def __init__(self, shared: Shared, settings: dict[str, Any]) -> None:
        self._shared, self._settings = shared, settings
        self.silence_s = float(settings["silence_s"])
        self.cycle_s = settings["cycle_ms"] * 1e-3
        self._composer = Composer(settings["sen_type"], settings["correction"], settings["stop_element"], settings["digital_outputs"])
        self._switches = bool(settings["digital_outputs"])
        self.counts = Counts()
        self._handshake = Handshake(self._composer, settings, self.counts)
        self._punctuality = Punctuality(self.cycle_s)
        self._layout: Layout | None = None
        self.over = False
        self._muted = self._closing = False
        self._unproven = False  # a fault came before the controller was seen to be absolute: only zero is safe
        self._follows = bool(settings["follow"])  # others move the arm
        self._seq = shared.command_seq
        self._arrival = Arrival()
        self.last_heard = self._close_began = 0.0
        self._stops = self._unanswered = 0
        self._rest_since: float | None = None  # since when the controller has had its last set point
        self._ready: tuple[bytes, bytes, bytes] | None = None  # what the next telegram must contain (IPOC, Delay), and its answer
        self._data = b""  # the last telegram
        self._unparsed = False  # it was answered before it was parsed
        self._taken: Taken | None = None

    @property
    def connected(self) -> bool:
        return self._layout is not None

    @property
    def controller(self) -> Any:
        """Address of the sender, as soon as the session has begun; None before."""
        return None if self._layout is None else self._layout.source

    # what the cycle calls

    def reply(self, data: bytes, source: Any, now: float, in_time: bool = True) -> bytes | None:
        """The answer to a datagram, or None. ``in_time``: False for one that is answered too late in any case."""
        ready = self._ready
        if ready is not None and in_time and self._is_next(ready, data, source, now):
            self._ready, self._data, self._unparsed, self.last_heard = None, data, True, now
            return ready[2]
        if self._muted or self.over:
            return None
        try:
            return self._reply_slowly(data, source, now, in_time)
        except SessionFault as fault:
            self._fail(fault)
            return None

    def _is_next(self, ready: tuple[bytes, bytes, bytes], data: bytes, source: Any, now: float) -> bool:
        """Whether this is the telegram that the answer which is ``ready`` is for."""
        return source == self.controller and not self._punctuality.held_up(now) and ready[1] in data and ready[0] in data

    @property
    def due(self) -> float | None:
        """Time at which the next telegram is expected, on the clock of ``now``; None if no answer to it is ready."""
        return None if self._ready is None else self._punctuality.due

    def rehearse(self, now: float) -> None:
        """Go the way of the next answer with the last telegram, whose IPOC is not the one that is waited for. Changes nothing."""
        if self._ready is not None:
            self._is_next(self._ready, self._data, self.controller, now)

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
            self._fail(
                SessionFault(
                    "silence", f"the controller sent no telegram for {now - self.last_heard:.2f} s{self._lateness.in_words}", muted=True
                )
            )
        self._poll_command(now)
        quiet = now - max(self.last_heard, self._close_began)
        if self._closing and (not self.connected or self._muted or quiet > (0.06 if self._stops else 0.3)):
            self.over = True

    def close(self, now: float) -> None:
        """Brake; once the arm stands, end the session."""
        if not self._closing:
            self._closing, self._close_began = True, now
            if self.connected:
                self._points.brake()
            elif self._handshake.layout is not None and not self._muted and not self._follows:
                self._handshake.give_up()
                return
            self.over = self._muted or not self.connected

    # telegrams that are not just the next one

    def _reply_slowly(self, data: bytes, source: Any, now: float, in_time: bool) -> bytes | None:
        layout = self._layout
        if layout is None:
            return self._shake_hands(data, source, now) if in_time else None  # its answer would not be sent
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
            return self._compose(digits, self._points.answer, self._stop)
        if kind != NEXT:
            return None
        held_up = self._punctuality.held_up(now)
        self._punctuality.take(now, steps)
        return self._reply_next(layout, digits, row, Taken(row, steps, in_time, held_up))

    def _shake_hands(self, data: bytes, source: Any, now: float) -> bytes | None:
        shake, failed = self._handshake, self._handshake.fault is not None
        try:
            answer = shake.take(data, source, now)
        finally:
            self._shared.note(shake.heard, source, shake.discarded)
        self.last_heard = now
        if answer is not None:
            self._punctuality.take(now, 1)
        if shake.fault is not None and not failed:
            self._fail(shake.fault)
        self._stops += self._closing
        self.over = self._stops > _STOP_CYCLES
        if shake.done is not None:
            self._data = data
            self._begin(shake.done)
        return answer

    def _reply_next(self, layout: Layout, digits: bytes, row: list[float], taken: Taken) -> bytes:
        points, steps, in_time = self._points, taken.steps, taken.in_time
        if steps > 1 and not self._follows and set_point_moved(layout, row):
            raise SessionFault("restart", "ASPos has changed, so the RSI program was restarted during the run", muted=True)
        self._unanswered += steps - 1
        delay = nan if layout.delay is None else row[layout.delay]
        rise = self._lateness.rise(delay, self._sequence.count * layout.tick_s) if isfinite(delay) else 0.0
        if rise or self._unanswered or taken.held_up or not in_time:
            points.doubt()
        else:
            points.accept()
            points.advance()
        self._unanswered = 0 if in_time else self._unanswered + 1
        self._taken = taken
        if self._lateness.too_many:
            self._fail(
                SessionFault(
                    "late",
                    f"the controller discarded {self._lateness.count:.0f} answers as late or invalid (Delay; late_limit is "
                    f"{self._settings['late_limit']}); check the network, the load of this computer and sen_type",
                )
            )
        return self._compose(digits, points.answer, self._stop)

    def _begin(self, layout: Layout) -> None:
        settings = self._settings
        digits, row = layout.parser.parse(self._data)
        window = max(1, round(settings["ride_out_s"] / self.cycle_s))
        self._sequence = Sequence(int(digits), layout.step, window, self.counts)
        self._lateness = Lateness(0.0 if layout.delay is None else row[layout.delay], settings["late_limit"], settings["late_window_s"])
        self._points = SetPoints(layout, settings, self.cycle_s, self._fail)
        measured = self._measured = layout.axes(row)
        self._plausibility = ArmPlausibility(layout.reference, measured, settings, self.cycle_s)
        self._standstill = Standstill(measured, layout.noise_deg, self.cycle_s)
        self._stop = self._faulted = self._at_once = False
        self._shared.decimals = layout.decimals
        self._command = self._seq
        self._shared.begin(layout.parser.names)
        self._layout, self._taken = layout, Taken(row)

    # the running session

    def _parse_answered(self) -> Taken:
        layout = self._layout
        assert layout is not None  # nothing is rendered in advance before the session has begun
        self._sequence.take(self._sequence.next)
        self._punctuality.take(self.last_heard, 1)
        self._points.accept()
        self._points.advance()
        try:
            _, row = layout.parser.parse(self._data)
        except Malformed as error:
            raise SessionFault("protocol", f"the controller sent a malformed telegram: {error}") from error
        if not finite(layout.axes(row)):
            raise SessionFault("protocol", "a telegram came without AIPos")
        return Taken(row)

    def _prepare(self, now: float) -> None:
        """Everything about the next answer, so that it only waits for its telegram."""
        layout = self._layout
        if layout is None or self._muted or self.over:
            self._ready = None
            return
        self._poll_command(now)
        self._points.prepare(self._measured, self._standstill)
        if self._muted:
            return
        self._stop = self._ending(now)
        if self._unanswered or self._muted:  # a controller that counts nothing must not get the next set point as if it had the last
            self._ready = None
            return
        delay = b""
        if layout.delay is not None:
            found = _DELAY.search(self._data)
            delay = found[0] if found else b"?"
        digits = b"%d" % self._sequence.next
        self._ready = (b"<IPOC>" + digits + b"</IPOC>", delay, self._compose(digits, self._points.next, self._stop))

    def _judge(self, taken: Taken, now: float) -> None:
        layout = self._layout
        assert layout is not None  # as above
        measured, time_s = layout.axes(taken.row), self._sequence.count * layout.tick_s
        self._standstill.take(measured, self._points.sent_moving)
        if not self._points.used_moving:
            self._arrival.judge(self._standstill.mean, time_s)
        flags = 0 if self._standstill.cycles >= _REST_CYCLES else MOVING
        flags |= (ARRIVED if self._arrival.arrived else 0) | (ANSWERED if taken.in_time else 0)
        self._shared.append(now, time_s, flags, self._command, self.counts, self._points.sent, taken.row)
        self._command = self._seq
        self._measured = measured
        self._plausibility.check(self._points.sent, measured, taken.steps)

    @property
    def _layout_now(self) -> Layout:
        assert self._layout is not None  # as above
        return self._layout

    def _compose(self, digits: bytes, position: tuple[float, ...] | None, stop: bool = False) -> bytes:
        outputs = self._outputs if self._switches else 0
        if self._follows or self._unproven and self._at_once:
            return self._composer.compose(ZERO, digits, stop, outputs)
        correction = None if position is None else tuple([p - r for p, r in zip(position, self._layout_now.reference, strict=True)])
        return self._composer.compose(correction, digits, stop, outputs)

    @property
    def _outputs(self) -> int:
        """Those that are to be on; none any more once the session ends, for whatever reason."""
        return 0 if self._faulted or self._closing else self._shared.outputs

    def _poll_command(self, now: float) -> None:
        if self._shared.command_seq == self._seq:
            return
        self._seq, command = self._shared.receive()
        if command.kind == CLOSE:
            self.close(now)
        elif not self.connected or self._shared.fault() is not None or self._closing:
            return
        elif command.kind == STOP:
            self._points.brake()
            self._arrival.abandon()
        elif command.kind == MOVE and self._follows:
            self._fail(SessionFault("refused", "the arm is only followed; nothing was moved"))
        elif command.kind == MOVE:
            self._begin_move(command)

    def _begin_move(self, command: RsiCommand) -> None:
        self._arrival.begin(command)
        if coarse := too_coarse(self._layout_now.decimals, command):
            self._fail(SessionFault("coarse", coarse))
        else:
            self._points.move(command)

    def _ending(self, now: float) -> bool:
        """Whether the controller is to end its session: at once after a fault of an arm that does not do what it is told, else once the arm
        stands. Where it cannot be told to, it is not answered any more."""
        if not (self._closing or self._faulted):
            return False
        if self._points.used_moving and not self._at_once:
            self._rest_since = None
            return False
        self._rest_since = now if self._rest_since is None else self._rest_since
        standing = self._standstill.cycles >= _END_CYCLES or now - self._rest_since > _SETTLE_S
        if not (standing or self._faulted):
            return False
        can_stop = bool(self._settings["stop_element"]) and (self._settings["stop_at_close"] or self._at_once)
        if not can_stop:
            self._muted, self.over = self._faulted, self._closing
            return False
        self._stops += self._closing
        self.over = self._stops > _STOP_CYCLES
        return True

    def _fail(self, fault: SessionFault) -> None:
        """The first fault is kept; it brakes the arm."""
        self._shared.fail(fault.kind, str(fault))
        self._arrival.abandon()
        if fault.muted:
            self._muted, self._ready = True, None
        if self.connected and not self._faulted:
            self._faulted, self._at_once, self._unproven = True, fault.kind in _AT_ONCE, self._points.unproven
            self._points.freeze() if self._at_once else self._points.brake()
