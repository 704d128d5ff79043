"""Positioner on a serial line whose words the plan describes: texts to send, patterns of the replies."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any

from pydantic import Field as Option
from pydantic import model_validator

from mbcacq.devices import (
    Aborted,
    ConfigError,
    ContextDevice,
    Description,
    DeviceFault,
    DeviceTimeout,
    DriverOptions,
    Field,
    ProtocolError,
    parse_options,
)
from mbcacq_bus.idle import IdlePoll
from mbcacq_bus.options import StationOptions
from mbcacq_bus.serial_link import SerialConnection, SerialLink, compiled

POLL_S = 0.05
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


class SerialPositioner(ContextDevice):
    """Sends where to go, then asks until it stands there."""

    asks = False

    options_model = SerialPositionerOptions

    first_contact = (
        "In a terminal program the device answers the question for its identity as the plan expects it.",
        "One station after another at reduced speed: the position that is read is where the stand is.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        o = self._options = parse_options(SerialPositionerOptions, DEVICE, options)
        self._model, self._stopped = model, threading.Event()
        self._link = SerialLink(f"positioner {model}".strip(), o, self._stopped)
        question = o.position or o.ready
        assert question is not None  # as the options demand
        self._idle = IdlePoll(lambda: self._link.ask(question.send), lambda: self._link.used, o.idle_poll_s if o.has_connection else 0.0)
        self._targets = {str(k): v for k, v in o.stations.items()}
        named = {
            "move.reply": o.move.reply,
            "ready.reply": o.ready and o.ready.reply,
            "position.reply": o.position and o.position.reply,
            "fault.reply": o.fault and o.fault.reply,
        }
        self._patterns = {option: compiled(pattern, DEVICE, option) for option, pattern in named.items() if pattern is not None}
        if o.position is not None and not self._patterns["position.reply"].groupindex.keys() & {"raw", "value"}:
            raise ConfigError(f"options of {DEVICE}: position.reply needs a named group, e.g. POS=(?P<raw>[-+0-9.]+); correct the plan")

    def connect(self) -> None:
        """Raises ConnectError, IdentityError."""
        self.close()
        self._stopped.clear()
        self._link.open()
        self._idle.start()

    def describe(self) -> Description:
        field = Field("position", self._options.unit, meaning="commanded position of the artefact")
        return Description("positioner", self._model, (field,))

    def go_to(self, station: str, prompt: str) -> None:
        """Raises ConfigError for an unknown station, DeviceTimeout, DeviceFault, ProtocolError, Aborted after ``stop``."""
        if station not in self._targets:
            raise ConfigError(f"the plan gives no position for station {station}; add it to the positioner's stations")
        target, text = self._targets[station], self._options.text_for(self._targets[station])
        self._stopped.clear()
        self._refuse_fault(station)
        if (pattern := self._patterns.get("move.reply")) is None:
            self._link.send(text)
        elif not pattern.fullmatch(line := self._link.ask(text)):
            raise DeviceFault(f"{self._link.name} answered '{line[:60]}' to '{text.strip()}'; is the position allowed, is it referenced?")
        self._wait(station, target)
        if self._stopped.wait(self._options.settle_s):
            raise Aborted(f"stopped on the way to station {station}")

    def stop(self) -> None:
        """Also sends the ``halt`` text where the plan names one, while a motion may be under way."""
        self._stopped.set()
        if self._options.halt is not None and self._link.connected:
            try:
                self._link.send(self._options.halt.send)
            except Exception:  # stop never raises; the positioner's own watchdog is the last line
                return

    def close(self) -> None:
        self._idle.stop()
        self.stop()
        self._link.close()

    def _wait(self, station: str, target: float) -> None:
        o, began, where = self._options, time.monotonic(), "in an unknown place"
        while True:
            if self._stopped.is_set():
                raise Aborted(f"stopped on the way to station {station}")
            self._refuse_fault(station)
            elapsed = time.monotonic() - began
            arrived = o.ready is None or bool(self._patterns["ready.reply"].fullmatch(self._link.ask(o.ready.send)))
            if o.position is not None:
                actual = self._position(o.position)
                where = f"at {actual:g} {o.unit}"
                arrived = arrived and abs(actual - target) <= o.tolerance
            elif elapsed < o.ready_delay_s:  # it may not have lowered its flag yet
                arrived = False
            if arrived:
                return
            if elapsed > o.move_timeout_s:
                raise DeviceTimeout(
                    f"{self._link.name} did not reach station {station} ({target:g} {o.unit}) within "
                    f"{o.move_timeout_s:g} s: it is {where}; see what holds it"
                )
            self._stopped.wait(POLL_S)

    def _refuse_fault(self, station: str) -> None:
        if self._options.fault is None:
            return
        if match := self._patterns["fault.reply"].fullmatch(self._link.ask(self._options.fault.send)):
            code = " ".join(filter(None, match.groups())) or match[0]
            raise DeviceFault(f"{self._link.name} reports fault {code} on the way to station {station}; clear it at its controller")

    def _position(self, query: Query) -> float:
        o, line = self._options, self._link.ask(query.send)
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
