"""A serial line with questions and answers, one at a time, with named errors: pyserial's ports, and socket://host:port."""

from __future__ import annotations

import re
import threading
import time
from typing import Any, Literal

from pydantic import Field

from mbcacq.devices import ConfigError, ConnectError, DeviceTimeout, DriverOptions, IdentityError, ProtocolError
from mbcacq_bus.serial_port import close_port, open_port, waiting_bytes

MAX_LINE = 1024
POLL_S = 0.05
_TRIES = 3  # for an identity
_QUIET = 1.1  # of the time-out: silence for longer than an answer may take
_LONGEST = 5.0  # time-outs waited for a line to fall silent
_STEP_S = 0.005


class SerialIdentity(DriverOptions):
    """Send ``ask`` on connecting; a line must match ``expect`` as a whole."""

    ask: str
    expect: str


class SerialPortOptions(DriverOptions):
    """port: a device's name (/dev/ttyUSB0, COM3), or socket://host:port of a serial server. terminator: ends each line that the device
    sends."""

    port: str
    baudrate: int = 9600
    parity: Literal["N", "E", "O"] = "N"
    stopbits: Literal[1, 2] = 1
    bytesize: Literal[7, 8] = 8
    terminator: str = Field(default="\n", min_length=1, max_length=4)
    timeout_s: float = Field(default=2.0, gt=0)
    identity: SerialIdentity | None = None


class SerialConnection(SerialPortOptions):
    """idle_poll_s: a line that nobody has used for so long is used once: serial servers close an idle connection, and the device may have
    moved; 0 for never."""

    idle_poll_s: float = Field(default=2.0, ge=0)


class LineLost(DeviceTimeout):
    """The far end has closed the connection, or the port is gone."""


class SerialLink:
    """``ask`` sends a text and returns the line that comes back. Raises ConnectError, DeviceTimeout, ProtocolError, IdentityError.

    A question that was not answered in time may be answered late. The next one waits until the line has been silent for longer than the
    time-out, and its own answer is the last line before another such silence. A connection that the far end has closed is opened again
    before anything is sent.

    stopped: ends such a wait while it is set.
    """

    def __init__(self, device: str, options: SerialPortOptions, stopped: threading.Event | None = None) -> None:
        self.name, self._device, self._options = f"{device} at {options.port}", device, options
        self._identity = None
        if options.identity is not None:
            self._identity = options.identity, compiled(options.identity.expect, device, "identity.expect")
        self._lock = threading.RLock()
        self._port: Any = None
        self._pending = b""  # the beginning of a line
        self._wanted = False  # by whoever opened it: a thread that still asks must not open again what was closed
        # When they were asked, time.monotonic; a line brings their answers after it was closed and opened, too.
        self._unanswered: list[float] = []
        self._stopped = stopped or threading.Event()
        self.used = time.monotonic()

    @property
    def connected(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Open the port and identify what is there. Raises ConnectError, IdentityError."""
        with self._lock:
            self.close()
            self._wanted = True
            try:
                self._open()
            except BaseException:
                self.close()
                raise

    def _open(self) -> None:
        if not self._wanted:
            raise ConnectError(f"{self.name} was closed")
        o = self._options
        line = {"baudrate": o.baudrate, "parity": o.parity, "stopbits": o.stopbits, "bytesize": o.bytesize}
        self._port, self._pending = open_port(self._device, o.port, **line, timeout=POLL_S, write_timeout=o.timeout_s), b""
        if not self._wanted:  # closed meanwhile
            self.close()
        if self._identity is not None:
            self._identify(*self._identity)

    def close(self) -> None:
        self._wanted = False
        port, self._port = self._port, None
        close_port(port)

    def send(self, text: str) -> None:
        """Send, and expect nothing; does not wait for a question under way."""
        if self._lock.acquire(blocking=False):  # else somebody is asking, on a connection that stands
            try:
                self._restore()
            finally:
                self._lock.release()
        self._write(text)

    def ask(self, text: str, fits: re.Pattern[str] | None = None) -> str:
        """Send, and return the next complete line that is neither empty nor an echo, and that ``fits`` as a whole; without its end."""
        with self._lock:
            self._restore()
            if self._unanswered:
                self._wait_for_silence(0.0)
            self._heard()  # is late or unasked, and nobody's answer
            sent, self._pending = time.monotonic(), b""
            self._write(text)
            try:
                line = self._line(text.strip(), fits)
            except DeviceTimeout:
                self._unanswered.append(sent)
                raise
            if self._unanswered:
                line = self._last_line(line, text.strip(), sent, fits)
            self.used = time.monotonic()
            return line

    def keep_in_step(self) -> None:
        """Have the next question wait until the line is silent, as after a time-out."""
        self._unanswered.append(time.monotonic())

    def read_line(self) -> str | None:
        """The next complete line, None where none is complete after a moment. Raises DeviceTimeout where the line is lost, ProtocolError
        for one without an end."""
        try:
            self._pending += self._opened().read_until(self._options.terminator.encode(), MAX_LINE)
        except ConnectError:
            raise
        except Exception as error:  # pyserial raises TypeError too, where another thread closes the port
            raise LineLost(f"{self.name} was lost: {error}; check the cable") from error
        if not self._pending.endswith(self._options.terminator.encode()):
            if len(self._pending) <= MAX_LINE:
                return None
            length, self._pending = len(self._pending), b""
            raise ProtocolError(f"{self.name} sent {length} bytes without an end of line; is the baud rate right?")
        line, self._pending = self._pending.decode("ascii", "replace").strip(), b""
        return line

    def _last_line(self, line: str, echo: str, sent: float, fits: re.Pattern[str] | None) -> str:
        """The last of the lines that follow ``line``: the first may be the late answer to an earlier question.

        This question's own answer comes as late after it as the first line came after the oldest question that was not answered.
        """
        timeout_s, now = self._options.timeout_s, time.monotonic()
        until = sent + min(now - self._unanswered[0], _LONGEST * timeout_s) + _QUIET * timeout_s
        self._unanswered = []
        heard = self._wait_for_silence(until).decode("ascii", "replace").split(self._options.terminator)
        lines = [text for part in heard[:-1] if _is_answer(text := part.strip(), echo, fits)]
        return lines[-1] if lines else line

    def _wait_for_silence(self, until: float) -> bytes:
        """Bytes that come until nothing has come for longer than the time-out, and not before ``until`` (time.monotonic)."""
        now, quiet_s, heard = time.monotonic(), _QUIET * self._options.timeout_s, b""
        end, silent_at = now + _LONGEST * self._options.timeout_s, max(now + quiet_s, until)
        while (now := time.monotonic()) < silent_at and not self._stopped.is_set():
            if now > max(end, until):
                raise DeviceTimeout(f"{self.name} does not fall silent after a question it had not answered; does it talk unasked?")
            if came := self._heard():
                heard, silent_at = (heard + came)[-MAX_LINE:], max(now + quiet_s, until)
            self._stopped.wait(_STEP_S)
        return heard

    def _identify(self, identity: SerialIdentity, expected: re.Pattern[str]) -> None:
        """A line has no connections: half a question of whoever asked before may garble ours, so it is asked again. The device may talk
        unasked, too."""
        timeout_s, began, asked, heard = self._options.timeout_s, time.monotonic(), 0, ""
        self._heard()
        while (elapsed := time.monotonic() - began) < timeout_s:
            if elapsed >= asked * timeout_s / _TRIES:
                self._write(identity.ask)
                asked += 1
            try:
                line = self.read_line() or ""
            except (DeviceTimeout, ProtocolError) as error:
                raise IdentityError(f"{self.name} cannot be identified: {error}") from error
            if expected.fullmatch(line):
                self._unanswered += [began] * (asked > 1)  # the answers to the others may come yet
                return
            heard = line or heard
        if not heard:
            raise IdentityError(
                f"{self.name} cannot be identified: it answered nothing to '{identity.ask.strip()[:40]}' within {timeout_s:g} s; is it on, "
                "and are baud rate and terminator right?"
            )
        raise IdentityError(f"{self.name} answered '{heard[:60]}' where '{identity.expect}' was expected; is this the right device?")

    def _heard(self) -> bytes:
        """Bytes that have come and were not read. Raises DeviceTimeout where the line is lost, or another thread closes it meanwhile."""
        port = self._opened()
        try:
            return waiting_bytes(port)
        except Exception as error:  # pyserial raises TypeError too, where another thread closes the port
            raise LineLost(f"{self.name} was lost: {error}; check the cable") from error

    def _write(self, text: str) -> None:
        port = self._opened()
        try:
            port.write(text.encode())
            port.flush()
        except Exception as error:  # not only OSError: pyserial lets termios.error and TypeError of a lost port through
            raise LineLost(f"{self.name} was lost: {error}; check the cable") from error

    def _restore(self) -> None:
        """Forget what came unasked, or too late for an earlier question; open the port again where its far end has closed it."""
        try:
            waiting_bytes(self._opened())
            return
        except ConnectError:
            raise
        except Exception as error:
            lost = error
        close_port(self._port)
        try:
            self._open()
        except IdentityError:
            raise
        except ConnectError as error:
            raise DeviceTimeout(f"{self.name} was lost ({lost}), and {error}") from error

    def _line(self, echo: str, fits: re.Pattern[str] | None) -> str:
        timeout_s, deadline = self._options.timeout_s, time.monotonic() + self._options.timeout_s
        while time.monotonic() < deadline:
            if (line := self.read_line()) is not None and _is_answer(line, echo, fits):
                return line
        if fits is not None:
            raise DeviceTimeout(
                f"{self.name} sent nothing that matches '{fits.pattern}' for {timeout_s:g} s; is it on, is the baud rate right?"
            )
        half = f" but half a line ('{self._pending[:40].decode('ascii', 'replace')}')" if self._pending else ""
        raise DeviceTimeout(
            f"{self.name} answered nothing{half} to '{echo[:40]}' within {timeout_s:g} s; is it on, and are baud rate and terminator right?"
        )

    def _opened(self) -> Any:
        if self._port is None:
            raise ConnectError(f"{self.name} is not connected")
        return self._port


def _is_answer(line: str, echo: str, fits: re.Pattern[str] | None) -> bool:
    return bool(line) and line != echo and (fits is None or fits.fullmatch(line) is not None)


def compiled(pattern: str, device: str, option: str) -> re.Pattern[str]:
    """Raises ConfigError naming the option."""
    try:
        return re.compile(pattern)
    except re.error as error:
        raise ConfigError(f"options of {device}: {option} is not a regular expression: {error}; correct the plan") from error
