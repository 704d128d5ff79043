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
    ProtocolError,
    parse_options,
)
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.serial_link import SerialPortOptions, compiled
from mbcacq_bus.serial_port import close_port, open_port

MAX_LINE = 1024
DEVICE = "the serial sensor"
ASKED = 3  # times, for its identity
_QUIET = 1.1  # of the time-out: silence for longer than an answer may take
_LONGEST = 5.0  # time-outs waited for silence


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
        identity = self._options.identity
        self._identity = None if identity is None else (identity, compiled(identity.expect, DEVICE, "identity.expect"))
        units = {name: self._options.units.get(name, "") for name in self._pattern.groupindex}
        self._plausible = Plausibility(units, self._options.max_rate)
        self._name = f"sensor {model}".strip()
        self._device = f"{self._name} at {self._options.port}"
        self._model = model
        self._port: Any = None
        self._thread: threading.Thread | None = None
        self._news = threading.Condition()
        self._values: dict[str, float] = {}
        self._stamp, self._failure, self._quit, self._late, self._lost = -math.inf, "", threading.Event(), False, False

    def connect(self) -> None:
        """Raises ConnectError, IdentityError."""
        o = self._options
        self._port = open_port(self._name, o.port, o.baudrate, o.parity, o.stopbits, timeout=0.2)
        try:
            self._identify()
        except BaseException:
            self.close()
            raise
        self._quit.clear()
        self._failure, self._lost, self._stamp = "", False, -math.inf
        self._thread = threading.Thread(target=self._listen, name="serial-sensor", daemon=True)
        self._thread.start()

    def describe(self) -> Description:
        return Description("sensor", self._model, tuple(Field(k, self._options.units.get(k, "")) for k in self._pattern.groupindex))

    def read(self) -> dict[str, float]:
        """The newest complete line's values. Raises DeviceTimeout, ProtocolError, DeviceFault (also where they cannot follow the last
        ones, read twice)."""
        values = self._read_once(time.monotonic() - self._options.timeout_s)
        return self._plausible.checked(self._device, values, self._read_again, time.monotonic)

    def facts(self) -> tuple[Fact, ...]:
        """A reading that was doubted and read again."""
        return self._plausible.facts()

    def _read_again(self) -> dict[str, float]:
        self._late = self._options.ask is not None  # what was read may have been the late answer to an earlier question
        return self._read_once(time.monotonic())

    def _read_once(self, oldest: float) -> dict[str, float]:
        """Values of a line that came at ``oldest`` (time.monotonic) or later, of a sensor that is asked of the answer to a new question."""
        if self._port is None:
            raise ConnectError(f"{self._device} is not connected")
        o = self._options
        for _ in range(2):  # a far end that closed the line unnoticed shows it only when it is asked; a question moves nothing
            self._restore()
            if o.ask is not None:
                self._await_silence()
                oldest = time.monotonic()
                if not self._sent(o.ask):
                    continue
            if self._came_since(oldest):
                return self._believed(dict(self._values))
            if not self._lost:
                break
        if self._failure:
            raise ProtocolError(f"{self._device}: {self._failure}")
        self._late = o.ask is not None
        raise DeviceTimeout(f"{self._device} sent nothing that matches '{o.line}' for {o.timeout_s:g} s; is it on, is the baud rate right?")

    def _came_since(self, oldest: float) -> bool:
        """Wait for values that are no older than a time (time.monotonic); False after the time-out or a failure."""
        with self._news:
            self._news.wait_for(lambda: self._stamp >= oldest or bool(self._failure), timeout=self._options.timeout_s)
            return self._stamp >= oldest

    def _sent(self, text: str) -> bool:
        """Whether a question left; where the line is lost, the reason is kept as the failure."""
        try:
            self._port.write(text.encode())
        except Exception as error:  # not only OSError: pyserial lets termios.error and TypeError of a lost port through
            with self._news:
                self._failure, self._lost = f"the connection was lost ({error})", True
            return False
        return True

    def _restore(self) -> None:
        """Open the port again where its far end has closed it since the last reading, e.g. a serial server an idle connection."""
        if self._thread is None or not self._lost:
            return
        lost = self._failure
        self.close()
        try:
            self.connect()
        except IdentityError:
            raise
        except ConnectError as error:
            raise DeviceTimeout(f"{self._device}: {lost}, and {error}") from error

    def _await_silence(self) -> None:
        """After a question that was not answered, wait until nothing has come for longer than the time-out: its answer may come late."""
        if not self._late:
            return
        quiet_s = _QUIET * self._options.timeout_s
        end, silent_at = time.monotonic() + _LONGEST * self._options.timeout_s, time.monotonic() + quiet_s
        with self._news:
            while (now := time.monotonic()) < min(silent_at, end) and not self._failure:
                stamp = self._stamp
                self._news.wait(min(silent_at, end) - now)
                if self._stamp != stamp:
                    silent_at = self._stamp + quiet_s
        self._late = False

    def _believed(self, values: dict[str, float]) -> dict[str, float]:
        for name, (low, high) in self._options.valid.items():
            if name in values and not low <= values[name] <= high:
                raise DeviceFault(f"{self._device} reports {values[name]:g} for {name}; is its probe connected?")
        return values

    def stop(self) -> None:
        pass

    def close(self) -> None:
        self._quit.set()
        port, self._port = self._port, None
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        close_port(port)

    def _send(self, text: str) -> None:
        try:
            self._port.write(text.encode())
        except Exception as error:  # as above
            raise DeviceTimeout(f"{self._device} was lost: {error}") from error

    def _identify(self) -> None:
        if self._identity is None:
            return
        identity, expected = self._identity
        # A line has no connections: half a question of whoever asked before may garble ours, so it is asked again.
        timeout_s, began, asked, heard, pending = self._options.timeout_s, time.monotonic(), 0, "", b""
        while (elapsed := time.monotonic() - began) < timeout_s:
            if elapsed >= asked * timeout_s / ASKED:
                self._send(identity.ask)
                asked += 1
            try:
                pending += self._port.read_until(b"\n", MAX_LINE)
            except Exception as error:  # pyserial lets termios.error of a lost terminal through
                raise ConnectError(f"{self._device} was lost while it was being identified: {error}; check the cable") from error
            if not pending.endswith(b"\n"):
                pending = pending[-MAX_LINE:]
                continue
            line, pending = pending.decode("ascii", "replace").strip(), b""
            if expected.fullmatch(line):
                return
            heard = line or heard
        raise IdentityError(f"{self._device} answered '{heard[:60]}' where '{identity.expect}' was expected; is this the right sensor?")

    def _listen(self) -> None:
        # A line that was already under way when we came may be cut, and a cut number is a wrong number.
        whole, port, pending = self._options.ask is not None or self._identity is not None, self._port, b""
        while not self._quit.is_set():
            try:
                pending += port.read_until(b"\n", MAX_LINE)
            except Exception as error:
                with self._news:
                    self._failure, self._lost = f"the connection was lost ({error})", True
                    self._news.notify_all()
                return
            if not pending.endswith(b"\n"):
                if len(pending) > MAX_LINE:
                    pending, whole = b"", False
                continue
            line, pending = pending.decode("ascii", "replace").strip(), b""
            if whole:
                self._take(line)
            whole = True

    def _scaled(self, name: str, number: float) -> float:
        return number * self._options.scale.get(name, 1.0) + self._options.offset.get(name, 0.0)

    def _take(self, line: str) -> None:
        match = self._pattern.fullmatch(line)
        if match is None:
            return
        try:
            values = {name: self._scaled(name, float(text)) for name, text in match.groupdict().items() if text is not None}
            if not all(map(math.isfinite, values.values())):
                raise ValueError("not finite")
        except ValueError:
            with self._news:
                self._failure = f"'{line[:60]}' matches the line pattern, but not every group is a number; correct the pattern"
                self._news.notify_all()
            return
        with self._news:
            self._values, self._stamp, self._failure = values, time.monotonic(), ""
            self._news.notify_all()
