"""Positioner on a serial line whose words the plan describes: texts to send, patterns of the replies."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from typing import Any

from pydantic import Field as Option
from pydantic import model_validator

from mbcacq.devices import ConfigError, DeviceFault, DriverOptions, ProtocolError, parse_options
from mbcacq_bus.serial_link import SerialConnection, SerialLink, compiled
from mbcacq_bus.stations import StationOptions, StationPositioner

DEVICE = "the serial positioner"


class Order(DriverOptions):
    """A text to send. reply: pattern of the line that acknowledges it, where there is one."""

    send: str
    reply: str | None = None


class Query(DriverOptions):
    """A question, and the pattern (of the whole line) of the reply that means yes; every other line means no."""

    send: str
    reply: str


class SerialPositionerOptions(StationOptions, SerialConnection):
    """Positions are in ``unit``. ``move.send`` holds {raw} or {value}, value = raw * scale + offset, with a format if
    need be ({raw:.0f}). ready: it stands where it should. position: a pattern with the named group raw or value. fault: a pattern whose
    match is a fault; its groups are reported. halt: stops the motion.
    """

    move: Order
    ready: Query | None = None
    position: Query | None = None
    fault: Query | None = None
    halt: Order | None = None
    unit: str = "mm"
    scale: float = Option(default=1.0)
    offset: float = 0.0
    ready_delay_s: float = Option(default=0.2, ge=0)

    @model_validator(mode="after")
    def _sound(self) -> SerialPositionerOptions:
        if self.ready is None and self.position is None:
            raise ValueError("give ready or position (or both), or nobody can tell when it has arrived")
        if self.scale == 0:
            raise ValueError("scale must not be zero")
        if self.text_for(1.0) == self.text_for(2.0):
            raise ValueError("move.send needs {raw} or {value}, the place to go to")
        self.refuse_outside(f" {self.unit}")
        return self

    def text_for(self, value: float) -> str:
        """What is sent to go to ``value``."""
        try:
            return self.move.send.format(raw=(value - self.offset) / self.scale, value=value)
        except (KeyError, IndexError, ValueError, AttributeError) as error:
            raise ValueError(f"move.send is no text with {{raw}} or {{value}}: {error}") from None


class SerialPositioner(StationPositioner):
    """Sends where to go, then asks until it stands there."""

    asks = False
    poll_s = 0.05

    options_model = SerialPositionerOptions

    first_contact = (
        "In a terminal program the device answers the question for its identity as the plan expects it.",
        "One station after another at reduced speed: the position that is read is where the stand is.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        o, stopped = parse_options(SerialPositionerOptions, DEVICE, options), threading.Event()
        link = SerialLink(f"positioner {model}".strip(), o, stopped)
        question = o.position or o.ready
        assert question is not None  # as the options demand
        super().__init__(model, o, link, lambda: link.ask(question.send), o.unit, o.ready_delay_s, stopped)
        named = {
            "move.reply": o.move.reply,
            "ready.reply": o.ready and o.ready.reply,
            "position.reply": o.position and o.position.reply,
            "fault.reply": o.fault and o.fault.reply,
        }
        self._patterns = {option: compiled(pattern, DEVICE, option) for option, pattern in named.items() if pattern is not None}
        if o.position is not None and not self._patterns["position.reply"].groupindex.keys() & {"raw", "value"}:
            raise ConfigError(f"options of {DEVICE}: position.reply needs a named group, e.g. POS=(?P<raw>[-+0-9.]+); correct the plan")

    def _begin(self, station: str, target: float) -> None:
        text = self._options.text_for(target)
        self._refuse_fault(f"on the way to station {station}")
        if (pattern := self._patterns.get("move.reply")) is None:
            self._link.send(text)
        elif not pattern.fullmatch(line := self._link.ask(text)):
            raise DeviceFault(f"{self._link.name} answered '{line[:60]}' to '{text.strip()}'; is the position allowed, is it referenced?")

    def _fault(self) -> str:
        if self._options.fault is None:
            return ""
        match = self._patterns["fault.reply"].fullmatch(self._link.ask(self._options.fault.send))
        return (" ".join(filter(None, match.groups())) or match[0]) if match else ""

    def _says_arrived(self) -> bool:
        ready = self._options.ready
        return ready is None or bool(self._patterns["ready.reply"].fullmatch(self._link.ask(ready.send)))

    def _halt(self) -> None:
        self._link.send(self._options.halt.send)

    def _position(self) -> float | None:
        o, query = self._options, self._options.position
        if query is None:
            return None
        line = self._link.ask(query.send)
        match = self._patterns["position.reply"].fullmatch(line)
        try:
            found = match.groupdict() if match else {}
            value = float(found["raw"]) * o.scale + o.offset if found.get("raw") is not None else float(found["value"])
        except (KeyError, TypeError, ValueError):
            raise ProtocolError(
                f"{self._link.name} answered '{line[:60]}' where '{query.reply}' was expected; is the pattern right?"
            ) from None
        if not math.isfinite(value):
            raise ProtocolError(f"{self._link.name} reports {value} as its position; is it referenced?")
        return value
