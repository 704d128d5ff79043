"""Asking a scanner's program for a cloud: by a command, a text over TCP or a serial line, an output of the robot, or a person."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

from mbcacq.devices import Aborted, ConfigError, ConnectError, DeviceFault, DeviceTimeout, MbcacqError, ProtocolError
from mbcacq_folder.options import TriggerOptions

POLL_S = 0.05
LISTENS_S = 0.2
LONGEST_REPLY = 4096


class CloudTrigger:
    """``stopped()``: whether the wait is to end."""

    def __init__(self, name: str, options: TriggerOptions, connect_timeout_s: float, stopped: Callable[[], bool]) -> None:
        self._name, self._options, self._connect_s, self._stopped = f"scanner '{name}'", options, connect_timeout_s, stopped
        self._set_output: Callable[[int, bool], None] | None = None
        self._numbers: tuple[int, ...] = ()
        try:
            self._reply = None if options.reply is None else re.compile(options.reply)
        except re.error as error:
            raise ConfigError(f"{self._name}: trigger.reply is no pattern ({error}); correct the plan") from error

    def use_outputs(self, set_output: Callable[[int, bool], None] | None, numbers: Sequence[int]) -> None:
        """How the robot's outputs are switched, and which may be; None if its driver cannot. Raises ConfigError if one is needed."""
        self._set_output, self._numbers, output = set_output, tuple(numbers), self._options.output
        if output is not None and set_output is None:
            raise ConfigError(
                f"{self._name}: trigger.output needs a robot whose driver switches outputs, which this one does not; trigger it by "
                "tcp, serial, command or person"
            )
        if output is not None and output not in self._numbers:
            raise ConfigError(
                f"{self._name}: trigger.output is {output}, which the robot may not switch; add digital_outputs: [{output}] to the robot's "
                "options, or trigger it by tcp, serial, command or person"
            )

    def check(self) -> None:
        """Whether there is somebody to ask. Raises ConnectError, ConfigError."""
        self.use_outputs(self._set_output, self._numbers)
        if self._options.tcp:
            with self._connected() as connection:
                connection.settimeout(LISTENS_S)
                try:
                    _received(connection)  # who is not there closes at once; who is says nothing, or a greeting
                except OSError as error:
                    raise ConnectError(
                        f"{self._name}: {self._options.tcp} ends the connection at once; is the program ready, is it the right port?"
                    ) from error
        elif self._options.serial:
            self._serial_port().close()

    def fire(self, deadline: float) -> None:
        """Ask once. Raises ConnectError, DeviceTimeout without a reply until ``deadline`` (monotonic), ProtocolError for another one,
        DeviceFault where a command fails, Aborted."""
        o = self._options
        if o.person:
            print(f"{self._name}: take one cloud now", file=sys.stderr, flush=True)
        elif o.command:
            self._run(deadline)
        elif o.output is not None:
            self._pulse(o.output, deadline)
        elif o.tcp:
            with self._connected() as connection:
                self._ask(connection.sendall, lambda: _received(connection), deadline)
        else:
            with self._serial_port() as port:
                self._ask(port.write, lambda: port.read(port.in_waiting or 1), deadline)

    def _pulse(self, number: int, deadline: float) -> None:
        """The output on for its time, and off in any case."""
        assert self._set_output is not None, "check looked"
        self._set_output(number, True)
        try:
            until = min(time.monotonic() + self._options.pulse_s, deadline)
            while (left := until - time.monotonic()) > 0:
                if self._stopped():
                    raise Aborted("the wait for the scanner was ended")
                time.sleep(min(left, POLL_S))
        finally:
            self._set_output(number, False)

    def _connected(self) -> socket.socket:
        assert self._options.tcp is not None
        host, port = self._options.tcp.rsplit(":", 1)
        try:
            connection = socket.create_connection((host, int(port)), self._connect_s)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConnectError(
                f"{self._name}: its program does not answer at {self._options.tcp} ({why}); start it, or correct the address"
            ) from error
        connection.settimeout(POLL_S)
        return connection

    def _serial_port(self):  # noqa: ANN202 (pyserial has no types)
        import serial

        try:
            return serial.serial_for_url(
                self._options.serial, baudrate=self._options.baudrate, timeout=POLL_S, write_timeout=self._connect_s
            )
        except (serial.SerialException, ValueError, OSError) as error:
            raise ConnectError(f"{self._name}: {self._options.serial} cannot be opened: {error}; correct trigger.serial") from error

    def _ask(self, send: Callable[[bytes], object], receive: Callable[[], bytes], deadline: float) -> None:
        try:
            send(self._options.send.encode("utf-8"))
            line = b""
            while self._reply is not None and b"\n" not in line:
                if self._stopped():
                    raise Aborted("the wait for the scanner was ended")
                if time.monotonic() > deadline:
                    raise DeviceTimeout(
                        f"{self._name}: its program did not acknowledge the trigger in time; is it ready, is trigger.reply right?"
                    )
                line += receive()
                if len(line) > LONGEST_REPLY:
                    raise ProtocolError(f"{self._name}: its program answers {len(line)} bytes without a line end; correct trigger.reply")
        except MbcacqError:
            raise  # some of them are errors of the system too
        except OSError as error:
            raise ConnectError(
                f"{self._name}: the connection to its program was lost ({error.strerror or error}); start it again"
            ) from error
        if self._reply is not None:
            text = line.split(b"\n")[0].decode("utf-8", "replace").strip()
            if not self._reply.fullmatch(text):
                raise ProtocolError(
                    f"{self._name}: its program answered '{text[:60]}' to the trigger; is it ready, is trigger.reply right?"
                )

    def _run(self, deadline: float) -> None:
        assert self._options.command is not None
        try:
            process = subprocess.Popen(self._options.command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        except OSError as error:
            raise ConnectError(
                f"{self._name}: the command {self._options.command[0]} cannot be started: {error.strerror}; correct it"
            ) from error
        with process:
            try:
                while process.poll() is None:
                    if self._stopped():
                        raise Aborted("the wait for the scanner was ended")
                    if time.monotonic() > deadline:
                        raise DeviceTimeout(
                            f"{self._name}: the command {self._options.command[0]} did not end in time; look at what it waits for"
                        )
                    time.sleep(POLL_S)
            finally:
                if process.poll() is None:
                    process.kill()
            if process.returncode:
                said = (process.stderr.read() if process.stderr else b"").decode("utf-8", "replace").strip().splitlines()
                raise DeviceFault(
                    f"{self._name}: the command ended with {process.returncode} ({said[-1][:100] if said else 'no message'}); look at it"
                )


def _received(connection: socket.socket) -> bytes:
    try:
        data = connection.recv(1024)
    except TimeoutError:
        return b""
    if not data:
        raise ConnectionResetError("it ended the connection")
    return data
