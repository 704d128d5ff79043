"""A fake lift or turntable that is driven by text lines, described as the driver's options describe it."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

from mbcacq_bus.serial_positioner import SerialPositionerOptions

from mbcacq_fakes.protocols.bus.line_for import fill, names, template
from mbcacq_fakes.protocols.bus.modbus import FakePositioner
from mbcacq_fakes.protocols.bus.serial_line import SerialLine

IDLE = "BUSY"  # said where a pattern must not match


class FakeSerialPositioner(SerialLine):
    """Understands the ``move`` text of the options, drives there in ``travel_s``, answers the queries accordingly.

    Faults: ``motion.stuck`` never arrives, ``motion.fault`` a code; those of SerialLine. Raises ValueError if the patterns of the
    options are more than literal text around named groups, so that no reply can be made up for them.
    """

    def __init__(self, options: SerialPositionerOptions, *, travel_s: float = 0.05, **settings: Any) -> None:
        self._options = options
        stations = {str(k): v for k, v in options.stations.items()}
        self.motion = FakePositioner(stations, travel_s=travel_s)
        self.halted, self._from, self._start = 0, next(iter(stations.values())), time.monotonic()
        self._moves = _pattern(options.move.send)
        self._replies: dict[str, list[Callable[[], str | None]]] = {}
        if options.identity is not None:
            self._answers_to(options.identity.ask, options.identity.expect, lambda text: text)
        for query, reply in ((options.fault, self._fault), (options.ready, self._ready), (options.position, self._position)):
            if query is not None:
                self._answers_to(query.send, query.reply, reply)
        self._moved = None if options.move.reply is None else template(options.move.reply)
        super().__init__(self._hear, end=options.terminator, **settings)

    def _answers_to(self, sent: str, pattern: str, reply: Callable[[str], str | None]) -> None:
        text = template(pattern)
        self._replies.setdefault(sent.strip(), []).append(lambda: reply(text))

    def _hear(self, line: str) -> str | None:
        if self._options.halt is not None and line == self._options.halt.send.strip():
            self.halted += 1
            return None
        if line in self._replies:
            said = [text for reply in self._replies[line] if (text := reply()) is not None]
            return said[0] if said else IDLE
        if (match := self._moves.fullmatch(line)) is not None:
            raw, o = match.groupdict().get("raw"), self._options
            value = float(match["value"]) if raw is None else float(raw) * o.scale + o.offset
            self._from = self._now()
            self.motion.written(value)
            return self._moved
        return "?"

    def _now(self) -> float:
        """Where it is: on a straight way in time from where the motion began."""
        if self.motion.target is None or self.motion.stuck:
            return self._from
        share = min((time.monotonic() - self.motion.began) / max(self.motion.travel_s, 1e-9), 1.0)
        return self._from + share * (self.motion.target - self._from)

    def _ready(self, text: str) -> str | None:
        return text if self.motion.arrived else None

    def _fault(self, text: str) -> str | None:
        return fill(text, dict.fromkeys(names(text), self.motion.fault)) if self.motion.fault else None

    def _position(self, text: str) -> str:
        now = self._now()
        return fill(text, {"raw": (now - self._options.offset) / self._options.scale, "value": now})


def _pattern(send: str) -> re.Pattern[str]:
    """What matches the lines that a text with {raw} or {value} in it makes."""
    literal = re.split(r"{(raw|value)[^}]*}", send.strip())
    parts = [re.escape(part) if k % 2 == 0 else rf"(?P<{part}>[-+0-9.eE]+)" for k, part in enumerate(literal)]
    return re.compile("".join(parts))
