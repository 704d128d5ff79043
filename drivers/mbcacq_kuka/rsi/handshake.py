"""The first telegrams of a session: who sends them, what they carry, by how much IPOC grows. All are answered without a correction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

from mbcacq_kuka.rsi.sequence import Counts
from mbcacq_kuka.rsi.telegram import Composer, Malformed, Parser, finite

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ZERO = (0.0,) * 6
WAITING_CYCLES = 2.5  # a network repeats a datagram within less; a peer that repeats itself later waits for its answer
_LEARN = 5  # telegrams answered with zero before the session counts as connected
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
    None; step: of IPOC; tick_s: seconds of one count of IPOC."""

    source: Any
    parser: Parser
    axes: Callable[[Sequence[float]], tuple[float, ...]]
    reference: tuple[float, ...]
    planned: Callable[[Sequence[float]], tuple[float, ...]] | None
    delay: int | None
    step: int = 0
    tick_s: float = 0.0


class Handshake:
    """``take`` every datagram until ``layout`` is there and ``done``. Raises SessionFault."""

    def __init__(self, composer: Composer, settings: dict[str, Any], counts: Counts) -> None:
        self._composer, self._settings, self._counts = composer, settings, counts
        self._useless = 0
        self._answer, self._answered = b"", 0.0
        self._ipocs: list[int] = []
        self.layout: Layout | None = None
        self.done: Layout | None = None

    def take(self, data: bytes, source: Any, now: float) -> bytes | None:
        """The answer, or None for a datagram that gets none: also one that the network repeats."""
        answer = self._take(data, source)
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
        if not finite(self.layout.axes(row)):
            raise SessionFault("protocol", "a telegram came without AIPos")
        return self._learn(digits)

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
        if planned is not None and self._settings["check_set_point"]:
            _refuse_correction(layout, row)
            # A small correction may still be applied, of a program that was not restarted: ASPos is where the arm goes without it.
            layout = replace(layout, reference=itemgetter(*planned)(row))
        self.layout = layout
        return self._learn(digits)

    def _no_use(self, reason: str) -> None:
        self._useless += 1
        if self._useless >= _USELESS:
            raise SessionFault("protocol", reason)

    def _learn(self, digits: bytes) -> bytes:
        ipoc, known = int(digits), self._ipocs
        if not known or ipoc > known[-1]:
            known.append(ipoc)
        if len(known) > _LEARN:
            self.done = self._finish()
        return self._composer.compose(ZERO, digits)

    def _finish(self) -> Layout:
        assert self.layout is not None  # telegrams are learnt from once their layout is known
        cycle_ms, known = self._settings["cycle_ms"], self._ipocs
        steps = {b - a for a, b in zip(known, known[1:], strict=False)}
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
        return replace(self.layout, step=step, tick_s=tick_s)


def _refuse_correction(layout: Layout, row: Sequence[float]) -> None:
    if layout.planned is None:
        return
    apart = max(abs(p - a) for p, a in zip(layout.planned(row), layout.reference, strict=True))
    if apart > _SET_POINT_DEG:
        raise SessionFault(
            "connect",
            f"AIPos and ASPos differ by {apart:.2f} deg, so the controller still applies an earlier correction; "
            "restart its RSI program (or set check_set_point: false if it does not report ASPos properly)",
            muted=True,
        )


def set_point_moved(layout: Layout, row: Sequence[float]) -> bool:
    """Whether ASPos left the place where the session began: then the controller has begun another one."""
    if layout.planned is None:
        return False
    return max(abs(p - a) for p, a in zip(layout.planned(row), layout.reference, strict=True)) > _SET_POINT_DEG
