"""The first telegrams of a session: who sends them, what they carry, by how much IPOC grows, how noisy and how finely written the joints
are; and whether the controller takes corrections as absolute. But for the probe of that (see mode) no correction is answered."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

from mbcacq_kuka.rsi.mode import AXIS, ModeProbe, Proof
from mbcacq_kuka.rsi.sequence import Counts, advance
from mbcacq_kuka.rsi.standstill import noise_of
from mbcacq_kuka.rsi.telegram import REPORT_ELEMENT, Composer, Malformed, Parser, decimals, finite, output_attribute

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ZERO = (0.0,) * 6
WAITING_CYCLES = 2.5  # a network repeats a datagram within less; a peer that repeats itself later waits for its answer
_LEARN = 7  # telegrams answered with zero before the controller is probed
_ANOTHER = 10_000  # IPOC further away than so many counts, some 10 s, is of another start of the program
_DISCARDED_SHARE = 0.6  # of our answers, by the Delay: it never takes one, and a busy computer or controller leaves out some of the count
_USELESS = 50  # telegrams that are no use before we say so: a controller sends as many in 0.2 s, a stray sender hardly
_SET_POINT_DEG = 0.1  # more between AIPos and ASPos is a correction that is still applied


class SessionFault(Exception):
    """What ends a session: kind (see driver), text, and whether nothing may be answered any more."""

    def __init__(self, kind: str, text: str, muted: bool = False) -> None:
        super().__init__(text)
        self.kind, self.muted = kind, muted


@dataclass(frozen=True)
class Layout:
    """What one session's telegrams look like. reference: axis angles (6,) deg without correction; planned: where ASPos stands in a row, or
    None; step: of IPOC; tick_s: seconds of one count of IPOC; noise_deg: standard deviation (6,) of the angles at rest; decimals:
    with how many they are written; carries_out: whether the arm was seen to carry out the probe's bump as an absolute correction."""

    source: Any
    parser: Parser
    axes: Callable[[Sequence[float]], tuple[float, ...]]
    reference: tuple[float, ...]
    planned: Callable[[Sequence[float]], tuple[float, ...]] | None
    delay: int | None
    step: int = 0
    tick_s: float = 0.0
    noise_deg: tuple[float, ...] = ZERO
    decimals: int = 0
    carries_out: bool = False

    def proof(self, settings: Mapping[str, Any]) -> Proof:
        """What must come before the first motion of an arm that was not seen to carry anything out."""
        wait, direction = lag_cycles(settings), roomy_direction(self.reference, settings)
        return Proof(self.reference, self.noise_deg[AXIS], 10.0**-self.decimals, wait, direction)


def lag_cycles(settings: Mapping[str, Any]) -> int:
    """How many cycles an arm may lag behind its commands."""
    return round(settings["follow_lag_s"] * 1e3 / settings["cycle_ms"])


def roomy_direction(reference: Sequence[float], settings: Mapping[str, Any]) -> float:
    """+1 or -1: where the last axis has room. reference: joints (6,) deg."""
    low, high = settings["limits_deg"][AXIS]
    return 1.0 if reference[AXIS] < 0.5 * (low + high) else -1.0


class Handshake:
    """``take`` every datagram until ``layout`` is there and ``done``. Raises SessionFault; after a ``fault`` every answer is a correction
    of zero and Stop."""

    def __init__(self, composer: Composer, settings: dict[str, Any], counts: Counts) -> None:
        self._composer, self._settings, self._counts = composer, settings, counts
        self._useless = self.heard = 0
        self._heard_at = 0.0
        self.source: Any = None
        self.fault: SessionFault | None = None
        self._start_over()

    def _start_over(self) -> None:
        self._answer, self._answered = b"", 0.0
        self._ipocs: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        self._delays: list[float] = []
        self._decimals = 0
        self._probe: ModeProbe | None = None
        self.layout: Layout | None = None
        self.done: Layout | None = None

    @property
    def discarded(self) -> float:
        """By how much the controller's Delay has risen."""
        return self._delays[-1] - self._delays[0] if self._delays else 0.0

    def give_up(self) -> None:
        """The listener goes away. A bump that is under way must not be held, so answers are zero and Stop from now on."""
        self.fault = self.fault or SessionFault("connect", "mbcacq ended while the session began")

    def take(self, data: bytes, source: Any, now: float) -> bytes | None:
        """The answer, or None for a datagram that gets none: also one that the network repeats."""
        if self.layout is not None and self.fault is None and now - self._heard_at > self._settings["silence_s"]:
            self._start_over()  # the program was started again
        self.heard, self.source = self.heard + 1, source
        answer = self._take(data, source)
        if self.layout is not None and source == self.layout.source:
            self._heard_at = now
        if answer is None or answer == self._answer and now - self._answered < WAITING_CYCLES * self._settings["cycle_ms"] * 1e-3:
            return None
        self._answer, self._answered = answer, now
        return answer

    def _take(self, data: bytes, source: Any) -> bytes | None:
        if self.layout is None:
            return self._first(data, source)
        if source != self.layout.source:
            self._counts.foreign += 1
            return None
        try:
            digits, row = self.layout.parser.parse(data)
        except Malformed as error:
            raise SessionFault("protocol", f"the controller sent a malformed telegram: {error}") from error
        if self.fault is not None:
            return self._composer.compose(ZERO, digits, stop=True)
        if not finite(self.layout.axes(row)):
            raise SessionFault("protocol", "a telegram came without AIPos")
        return self._learn(data, digits, row)

    def _first(self, data: bytes, source: Any) -> bytes | None:
        try:
            parser = Parser(data)
            digits, row = parser.parse(data)
        except Malformed as error:
            self._no_use(f"datagrams arrive from {source[0]}:{source[1]}, but they are no RSI telegrams: {error}")
            return None
        wanted = self._settings["controller_ip"]
        if wanted and source[0] != wanted:
            self._counts.foreign += 1
            self._no_use(f"telegrams come from {source[0]}, not from the controller at {wanted}")
            return None
        slots = parser.slots("AIPos", AXES)
        if slots is None:  # RSI 2 may begin with a nearly empty telegram
            self._no_use("the telegrams carry no AIPos; add DEF_AIPos to the SEND section of the RSI Ethernet configuration")
            return self._composer.compose(ZERO, digits)
        delay, planned = parser.slots("Delay", ("D",)), parser.slots("ASPos", AXES)
        axes: Callable[[Sequence[float]], tuple[float, ...]] = itemgetter(*slots)
        layout = Layout(
            source, parser, axes, axes(row), None if planned is None else itemgetter(*planned), None if delay is None else delay[0]
        )
        _refuse_missing_outputs(parser, self._settings["digital_outputs"])
        if planned is not None and self._settings["check_set_point"]:
            _refuse_correction(layout, row)
            # A small correction may still be applied, of a program that was not restarted: ASPos is where the arm goes without it.
            layout = replace(layout, reference=itemgetter(*planned)(row))
        self.layout = layout
        return self._learn(data, digits, row)

    def _no_use(self, reason: str) -> None:
        self._useless += 1
        if self._useless >= _USELESS:
            raise SessionFault("protocol", reason)

    def _learn(self, data: bytes, digits: bytes, row: Sequence[float]) -> bytes | None:
        layout, ipoc, known = self.layout, int(digits), self._ipocs
        assert layout is not None  # telegrams are learnt from once their layout is known
        if known and abs(advance(known[-1], ipoc)) > _ANOTHER:
            self._start_over()
            return self._first(data, layout.source)
        if known and advance(known[-1], ipoc) <= 0:  # repeated by the network, or late
            return self._answer if self._answer.endswith(b"<IPOC>" + digits + b"</IPOC></Sen>") else None
        known.append(ipoc)
        self._rows.append(layout.axes(row))
        self._decimals = max(self._decimals, decimals(data, "AIPos"))
        if layout.delay is not None and finite((row[layout.delay],)):
            self._delays.append(row[layout.delay])
        if len(known) <= _LEARN:
            return self._composer.compose(ZERO, digits)
        if self._settings["follow"]:
            # The layout alone: no correction is sent to an arm that is only followed.
            self.done = self._finish(self._begin_probe(layout))
            return self._composer.compose(ZERO, digits)
        if self._probe is None:
            self._probe = self._begin_probe(layout)
        correction = self._probe.next(self._rows[-1])
        if self._probe.done:
            self.fault = self._judge(self._probe)
            if self.fault is None:
                self.done = self._finish(self._probe)
        return self._composer.compose(correction, digits, stop=self.fault is not None)

    def _begin_probe(self, layout: Layout) -> ModeProbe:
        layout = self.layout = self._with_step(layout)
        if not (layout.planned is not None and self._settings["check_set_point"]):  # else it is ASPos, which is known better than AIPos
            mean = tuple([sum(values) / len(values) for values in zip(*self._rows, strict=True)])
            self.layout = replace(layout, reference=mean)
        direction = roomy_direction(layout.reference, self._settings)
        return ModeProbe(self._rows, noise_of(self._rows)[AXIS], lag_cycles(self._settings), direction)

    def _judge(self, probe: ModeProbe) -> SessionFault | None:
        if probe.relative:
            return SessionFault(
                "connect",
                "the controller adds each correction to the ones before, as RSI_ON(#RELATIVE) does; mbcacq sends absolute corrections, "
                "which would make such an arm run away: use RSI_ON(#ABSOLUTE) in the controller's program. Nothing was moved",
            )
        if self._delays and self.discarded >= _DISCARDED_SHARE * (len(self._delays) - 1):
            return SessionFault(
                "connect",
                f"the controller discards every answer (its Delay rose by {self.discarded:.0f} in {len(self._delays) - 1} cycles); is "
                f"sen_type '{self._settings['sen_type']}' the SENTYPE of its RSI Ethernet configuration? If so, the answers come too late: "
                "look at the network and the load of this computer",
            )
        if not probe.conclusive:
            return SessionFault(
                "connect",
                f"A{AXIS + 1} is too restless, by {noise_of(self._rows)[AXIS]:.3f}°, to tell whether the controller takes corrections "
                "as absolute; connect when the arm stands",
            )
        return None

    def _finish(self, probe: ModeProbe) -> Layout:
        assert self.layout is not None  # as above
        noise = tuple(noise_of(self._rows))
        carries_out = probe.response.came_and_went(10.0**-self._decimals, noise[AXIS])
        return replace(self.layout, noise_deg=noise, decimals=self._decimals, carries_out=carries_out)

    def _with_step(self, layout: Layout) -> Layout:
        cycle_ms, known = self._settings["cycle_ms"], self._ipocs
        steps = {advance(a, b) for a, b in zip(known, known[1:], strict=False)}
        if steps == {1}:  # simulators that count telegrams
            step, tick_s = 1, cycle_ms * 1e-3
        elif min(steps) == cycle_ms and all(s % cycle_ms == 0 for s in steps):
            step, tick_s = cycle_ms, 1e-3
        else:
            raise SessionFault(
                "protocol",
                f"IPOC advances by {min(steps)} a telegram, expected {cycle_ms}; set cycle_ms to 4 for #IPO_FAST, to 12 for #IPO",
                muted=True,
            )
        return replace(layout, step=step, tick_s=tick_s)


def _refuse_missing_outputs(parser: Parser, numbers: Sequence[int]) -> None:
    """A controller that reports an output has files that let it be switched, too; one that does not would do nothing, without a word."""
    for number in numbers:
        if parser.slots(REPORT_ELEMENT, (output_attribute(number),)) is None:
            raise SessionFault(
                "connect",
                f"its telegrams do not report output {number} ({REPORT_ELEMENT}), so the files on the controller are older than the plan's "
                "option digital_outputs, or of RSI before 4.1, and would not switch it; copy those that `mbcacq controller-files` writes. "
                "Nothing was moved",
                muted=True,
            )


def _refuse_correction(layout: Layout, row: Sequence[float]) -> None:
    if layout.planned is None:
        return
    apart = max(abs(p - a) for p, a in zip(layout.planned(row), layout.reference, strict=True))
    if apart > _SET_POINT_DEG:
        raise SessionFault(
            "connect",
            f"AIPos and ASPos differ by {apart:.2f}°, so the controller still applies an earlier correction; "
            "restart its RSI program (or set check_set_point: false if it does not report ASPos properly)",
            muted=True,
        )


def set_point_moved(layout: Layout, row: Sequence[float]) -> bool:
    """Whether ASPos left the place where the session began: then the controller has begun another one."""
    if layout.planned is None:
        return False
    return max(abs(p - a) for p, a in zip(layout.planned(row), layout.reference, strict=True)) > _SET_POINT_DEG
