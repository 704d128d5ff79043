"""A sensor that talks in text lines over a serial port (or a serial server: socket://host:port)."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field as Option

from mbcacq.devices import (
    ConfigError,
    ConnectError,
    ContextDevice,
    Description,
    DeviceFault,
    DeviceTimeout,
    Fact,
    Field,
    IdentityError,
    MbcacqError,
    ProtocolError,
    parse_options,
)
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.serial_link import LineLost, SerialLink, SerialPortOptions, compiled

DEVICE = "the serial sensor"


class SerialOptions(SerialPortOptions):
    """line: regular expression for a whole line; its named groups are the values, each times its ``scale`` plus its ``offset``. ask: sent
    before each reading, if needed. valid: by name, what may be read; beyond it the probe is taken to be broken. max_rate: by name, how
    fast it can change, unit/s; a faster change is read again and then refused."""

    line: str
    ask: str | None = None
    units: dict[str, str] = {}
    scale: dict[str, float] = {}
    offset: dict[str, float] = {}
    valid: dict[str, tuple[float, float]] = {}
    max_rate: dict[str, Annotated[float, Option(gt=0)]] = {}


class SerialSensor(ContextDevice):
    """Keeps the latest line in a thread, so that a reading is never older than ``timeout_s`` and never waits without need."""

    options_model = SerialOptions

    first_contact = ("The value that `mbcacq doctor {plan}` reads is the one on the device's display, in the unit of the plan.",)

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._options = parse_options(SerialOptions, DEVICE, options)
        self._pattern = compiled(self._options.line, DEVICE, "line")
        if not self._pattern.groupindex:
            raise ConfigError("options of the serial sensor: line needs named groups, e.g. T=(?P<air_C>[-+0-9.]+); correct the plan")
        for option in ("units", "scale", "offset", "valid", "max_rate"):
            if unknown := getattr(self._options, option).keys() - self._pattern.groupindex.keys():
                raise ConfigError(f"options of the serial sensor: {option} names '{min(unknown)}', which line does not; correct the plan")
        units = {name: self._options.units.get(name, "") for name in self._pattern.groupindex}
        self._plausible = Plausibility(units, self._options.max_rate)
        self._link = SerialLink(f"sensor {model}".strip(), self._options)
        self._model = model
        self._thread: threading.Thread | None = None
        self._news = threading.Condition()
        self._values: dict[str, float] = {}
        self._stamp, self._failure, self._quit, self._lost = -math.inf, "", threading.Event(), False

    def connect(self) -> None:
        """Raises ConnectError, IdentityError."""
        self._link.open()
        self._quit, self._failure, self._lost, self._stamp = threading.Event(), "", False, -math.inf
        if self._options.ask is None:
            self._thread = threading.Thread(target=self._listen, args=(self._quit,), name="serial-sensor", daemon=True)
            self._thread.start()

    def describe(self) -> Description:
        return Description("sensor", self._model, tuple(Field(k, self._options.units.get(k, "")) for k in self._pattern.groupindex))

    def read(self) -> dict[str, float]:
        """The newest complete line's values. Raises DeviceTimeout, ProtocolError, DeviceFault (also where they cannot follow the last
        ones, read twice)."""
        values = self._read_once(time.monotonic() - self._options.timeout_s)
        return self._plausible.checked(self._link.name, values, self._read_again, time.monotonic)

    def facts(self) -> tuple[Fact, ...]:
        """A reading that was doubted and read again."""
        return self._plausible.facts()

    def _read_again(self, doubted: bool) -> dict[str, float]:
        if doubted:
            self._link.keep_in_step()  # what was read may have been the late answer to an earlier question
        return self._read_once(time.monotonic())

    def _read_once(self, oldest: float) -> dict[str, float]:
        """Values of a line that came at ``oldest`` (time.monotonic) or later, of a sensor that is asked of the answer to a new question."""
        o, name = self._options, self._link.name
        if o.ask is not None:
            try:
                line = self._link.ask(o.ask, self._pattern)
            except LineLost:  # a far end may show only when it is asked that it has closed; a question moves nothing
                line = self._link.ask(o.ask, self._pattern)
            return self._believed(self._numbers(line))
        if not self._link.connected:
            raise ConnectError(f"{name} is not connected")
        if self._lost:
            self._restore()
        if self._came_since(oldest):
            return self._believed(dict(self._values))
        if self._failure:
            raise ProtocolError(self._failure)
        raise DeviceTimeout(f"{name} sent nothing that matches '{o.line}' for {o.timeout_s:g} s; is it on, is the baud rate right?")

    def _came_since(self, oldest: float) -> bool:
        """Wait for values that are no older than a time (time.monotonic); False after the time-out or a failure."""
        with self._news:
            self._news.wait_for(lambda: self._stamp >= oldest or bool(self._failure), timeout=self._options.timeout_s)
            return self._stamp >= oldest

    def _restore(self) -> None:
        """Open the port again where its far end has closed it since the last reading, e.g. a serial server an idle connection."""
        lost = self._failure
        self.close()
        try:
            self.connect()
        except IdentityError:
            raise
        except ConnectError as error:
            raise DeviceTimeout(f"{lost}, and {error}") from error

    def _believed(self, values: dict[str, float]) -> dict[str, float]:
        for name, (low, high) in self._options.valid.items():
            if name in values and not low <= values[name] <= high:
                raise DeviceFault(f"{self._link.name} reports {values[name]:g} for {name}; is its probe connected?")
        return values

    def stop(self) -> None:
        pass

    def close(self) -> None:
        self._quit.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        self._link.close()

    def _listen(self, ended: threading.Event) -> None:
        # A line that was already under way when we came may be cut, and a cut number is a wrong number.
        whole = self._options.identity is not None
        while not ended.is_set():
            try:
                line = self._link.read_line()
            except ProtocolError:
                whole = False
                continue
            except MbcacqError as error:
                self._take({}, str(error), lost=True)
                return
            if line is not None and whole and self._pattern.fullmatch(line):
                try:
                    self._take(self._numbers(line))
                except ProtocolError as error:
                    self._take({}, str(error))
            whole = whole or line is not None

    def _take(self, values: dict[str, float], failure: str = "", lost: bool = False) -> None:
        with self._news:
            self._failure, self._lost = failure, lost
            if not failure:
                self._values, self._stamp = values, time.monotonic()
            self._news.notify_all()

    def _numbers(self, line: str) -> dict[str, float]:
        """Values of a line that matches the pattern. Raises ProtocolError."""
        match, o = self._pattern.fullmatch(line), self._options
        found = {} if match is None else match.groupdict()
        try:
            values = {n: float(text) * o.scale.get(n, 1.0) + o.offset.get(n, 0.0) for n, text in found.items() if text is not None}
        except ValueError:
            values = {"": math.nan}
        if not all(map(math.isfinite, values.values())):
            raise ProtocolError(
                f"{self._link.name}: '{line[:60]}' matches the line pattern, but not every group is a number; correct the pattern"
            )
        return values
