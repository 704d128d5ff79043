"""A serial line with questions and answers, one at a time, with named errors: pyserial's ports, and socket://host:port."""

from __future__ import annotations

import re
import threading
import time
from contextlib import suppress
from typing import Any, Literal

from pydantic import Field

from mbcacq.devices import ConfigError, ConnectError, DeviceTimeout, IdentityError, ProtocolError
from mbcacq_bus.options import BusOptions

MAX_LINE = 1024
POLL_S = 0.05
_TRIES, _QUIET_S = 3, 0.3


class SerialIdentity(BusOptions):
    """Send ``ask`` on connecting; a line must match ``expect`` as a whole."""

    ask: str
    expect: str


class SerialConnection(BusOptions):
    """port: a device's name (/dev/ttyUSB0, COM3), or socket://host:port of a serial server. terminator: ends each line it sends."""

    port: str
    baudrate: int = 9600
    bytesize: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stopbits: Literal[1, 2] = 1
    terminator: str = Field(default="\n", min_length=1, max_length=4)
    timeout_s: float = Field(default=2.0, gt=0)
    identity: SerialIdentity | None = None


class SerialLink:
    """``ask`` sends a text and returns the line that comes back. Raises ConnectError, DeviceTimeout, ProtocolError, IdentityError."""

    def __init__(self, device: str, options: SerialConnection) -> None:
        self.name, self._options = f"{device} at {options.port}", options
        self._identity = None
        if options.identity is not None:
            self._identity = options.identity, compiled(options.identity.expect, device, "identity.expect")
        self._lock = threading.Lock()
        self._port: Any = None

    @property
    def connected(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Open the port and identify what is there."""
        import serial

        o = self._options
        try:
            self._port = serial.serial_for_url(
                o.port,
                baudrate=o.baudrate,
                bytesize=o.bytesize,
                parity=o.parity,
                stopbits=o.stopbits,
                timeout=POLL_S,
                write_timeout=o.timeout_s,
            )
        except (serial.SerialException, ValueError, OSError) as error:
            raise ConnectError(
                f"{self.name} cannot be opened: {error}; check the port's name, the cable and your right to use it"
            ) from error
        if self._identity is not None:
            try:
                self._identify(*self._identity)
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            sock = getattr(port, "_socket", None)  # pyserial leaves the socket of a lost connection open
            with suppress(Exception):
                port.close()
            if sock is not None:
                sock.close()

    def send(self, text: str) -> None:
        """Send, and expect nothing; does not wait for a question under way."""
        self._write(text)

    def ask(self, text: str) -> str:
        """Send, and return the next complete line that is neither empty nor an echo, without its end."""
        with self._lock:
            self._forget()
            self._write(text)
            return self._line(text.strip())

    def _identify(self, identity: SerialIdentity, expected: re.Pattern[str]) -> None:
        """A line has no connections: the first thing heard may be a late reply to whoever asked before us, so it is asked again."""
        line = ""
        for _ in range(_TRIES):
            try:
                line = self.ask(identity.ask)
            except (DeviceTimeout, ProtocolError) as error:
                raise IdentityError(f"{self.name} cannot be identified: {error}") from error
            if expected.fullmatch(line):
                return
            time.sleep(min(_QUIET_S, self._options.timeout_s))
        raise IdentityError(f"{self.name} answered '{line[:60]}' where '{identity.expect}' was expected; is this the right device?")

    def _write(self, text: str) -> None:
        port = self._opened()
        try:
            port.write(text.encode())
            port.flush()
        except Exception as error:  # not only OSError: pyserial lets termios.error and TypeError of a lost port through
            raise DeviceTimeout(f"{self.name} was lost: {error}; check the cable") from error

    def _forget(self) -> None:
        """What came unasked, or too late for an earlier question, is no answer to this one."""
        try:
            self._opened().reset_input_buffer()
        except ConnectError:
            raise
        except Exception as error:
            raise DeviceTimeout(f"{self.name} was lost: {error}; check the cable") from error

    def _line(self, echo: str) -> str:
        port, end, pending = self._opened(), self._options.terminator.encode(), b""
        deadline = time.monotonic() + self._options.timeout_s
        while time.monotonic() < deadline:
            try:
                pending += port.read_until(end, MAX_LINE)
            except Exception as error:  # pyserial raises TypeError too, where another thread closes the port
                raise DeviceTimeout(f"{self.name} was lost: {error}; check the cable") from error
            if pending.endswith(end):
                line, pending = pending.decode("ascii", "replace").strip(), b""
                if line and line != echo:
                    return line
            elif len(pending) > MAX_LINE:
                raise ProtocolError(f"{self.name} sent {len(pending)} bytes without an end of line; is the baud rate right?")
        half = f" but half a line ('{pending[:40].decode('ascii', 'replace')}')" if pending else ""
        raise DeviceTimeout(
            f"{self.name} answered nothing{half} to '{echo[:40]}' within {self._options.timeout_s:g} s; is it on, and are "
            "baud rate and terminator right?"
        )

    def _opened(self) -> Any:
        if self._port is None:
            raise ConnectError(f"{self.name} is not connected")
        return self._port


def compiled(pattern: str, device: str, option: str) -> re.Pattern[str]:
    """Raises ConfigError naming the option."""
    try:
        return re.compile(pattern)
    except re.error as error:
        raise ConfigError(f"options of {device}: {option} is not a regular expression: {error}; correct the plan") from error
