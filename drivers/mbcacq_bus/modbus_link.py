"""A Modbus connection, TCP or serial RTU: one request at a time, and never an answer taken for another's."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mbcacq.devices import ConnectError, DeviceFault, DeviceTimeout, IdentityError
from mbcacq_bus.modbus_connection import Connection, Identity
from mbcacq_bus.modbus_transport import Closed, Transport
from mbcacq_bus.registers import Register

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # its failures reach the user as our errors, once

REASONS = {
    1: "the function is not supported",
    2: "there is no such address",
    3: "the value is not allowed",
    4: "the device failed",
    6: "the device is busy",
    10: "the gateway has no path to that unit",
    11: "the unit behind the gateway does not answer",
}
NO_UNIT = (10, 11)  # said by a gateway of a unit, not by a device of its registers


_QUIET = 1.1  # of the time-out: silence for longer than an answer may take
_LONGEST = 5.0  # time-outs waited for a line to fall silent, and for a second answer
_FUNCTIONS = {"holding": 3, "input": 4, "coil": 1, "discrete": 2}
_MULTIPLE_REGISTERS, _ONE_COIL = 16, 5


class _NoAnswer(Exception):
    """No answer to this request came; it may still come."""


@dataclass(frozen=True)
class _Request:
    """send: the call of pymodbus. function: its code. fits: whether an answer is of the shape asked for. moves: it is no mere reading."""

    send: Callable[[Any], Any]
    function: int
    fits: Callable[[Any], bool]
    what: str
    moves: bool = False


class ModbusLink:
    """Reads and writes ``Register`` values. Safe to use from several threads; they take turns.

    An answer is that to the request just sent; earlier input is discarded. After a time-out TCP connects anew, and a serial line is left
    alone until it has been silent for longer than the time-out. An answer of another unit, function or length is none. The first answer
    after a time-out is confirmed: if a second one follows, the request is made again.

    A connection that the far end has closed, e.g. as idle, is opened again before a request, and for a reading also where it breaks
    meanwhile. A request to write is not repeated after its connection has broken.
    """

    def __init__(self, device: str, options: Connection) -> None:
        self._device, self._options = device, options
        self.name = f"{device} at {options.address}"
        self._lock = threading.RLock()
        self._transport: Transport | None = None
        self._hurry = threading.Event()
        # When they were sent, time.monotonic; a line brings their answers after it was closed and opened, too.
        self._unanswered: list[float] = []
        self.used = time.monotonic()

    @property
    def connected(self) -> bool:
        return self._transport is not None

    def open(self) -> None:
        """Connect and identify. Raises ConnectError, IdentityError."""
        with self._lock:
            self.close()
            self._hurry.clear()
            self._transport = Transport(self._device, self._options)
            try:
                self._connect(self._transport)
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def read(self, register: Register) -> float:
        """Its value in its unit. Raises ConnectError, DeviceTimeout, DeviceFault."""
        return _value(register, self._ask(self._reading(register)))

    def write(self, register: Register, value: float, urgent: bool = False) -> None:
        """Write a value in its unit. urgent: whoever waits for a line to fall silent makes room.

        Raises ValueError if it does not fit, ConnectError, DeviceTimeout, DeviceFault.
        """
        request = self._writing(register, value)
        if urgent:
            self._hurry.set()
        try:
            self._ask(request, urgent)
        finally:
            if urgent:
                self._hurry.clear()

    def keep_in_step(self) -> None:
        """Have the next request wait until the line is silent, as after a time-out."""
        with self._lock:
            self._miss(time.monotonic())

    def _reading(self, register: Register) -> _Request:
        where, n = {"address": register.address, "count": register.count, "device_id": self._options.device_id}, register.count
        send: Callable[[Any], Any] = {
            "holding": lambda client: client.read_holding_registers(**where),
            "input": lambda client: client.read_input_registers(**where),
            "coil": lambda client: client.read_coils(**where),
            "discrete": lambda client: client.read_discrete_inputs(**where),
        }[register.table]

        def fits(answer: Any) -> bool:
            return len(answer.bits) == 8 if register.is_bit else len(answer.registers) == n

        return _Request(send, _FUNCTIONS[register.table], fits, f"reading {register.table} {register.address}")

    def _writing(self, register: Register, value: float) -> _Request:
        what, at, unit = f"writing {register.table} {register.address}", register.address, self._options.device_id
        if register.table == "coil":
            on = bool(value)
            return _Request(
                lambda client: client.write_coil(at, on, device_id=unit),
                _ONE_COIL,
                lambda answer: answer.address == at and list(answer.bits[:1]) == [on],
                what,
                moves=True,
            )
        words = register.encode(value)
        return _Request(
            lambda client: client.write_registers(at, words, device_id=unit),
            _MULTIPLE_REGISTERS,
            lambda answer: (answer.address, answer.count) == (at, len(words)),
            what,
            moves=True,
        )

    def _ask(self, request: _Request, urgent: bool = False) -> Any:
        with self._lock:
            why = "was not asked"
            self._restore()
            for _ in range(self._options.retries + 1):
                if self._hurry.is_set() and not urgent:
                    break
                try:
                    if not self._opened().is_open:
                        self._restore()
                    return self._accepted(request)
                except _NoAnswer as error:
                    why = str(error)
                except Closed as error:
                    why = "broke the connection"
                    if request.moves:
                        raise DeviceTimeout(f"{self.name} {why} while {request.what}") from error
                    self._restore()
            raise DeviceTimeout(f"{self.name} {why} while {request.what}")

    def _accepted(self, request: _Request) -> Any:
        """The answer to this request. Raises _NoAnswer, Closed, DeviceFault."""
        self._settle()
        answer, sent = self._exchange(request)
        if self._unanswered and self._second_answer(sent) and not request.moves:
            answer, _ = self._exchange(request)
        self.used = time.monotonic()
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            reason = REASONS.get(code, f"exception code {code}")
            raise DeviceFault(f"{self._device} refused {request.what}: {reason}; {self._cure(code)}")
        return answer

    def _cure(self, code: int) -> str:
        if code in NO_UNIT:
            return f"check the device id ({self._options.device_id} in the plan) and that the unit is switched on and wired to the gateway"
        return "check the registers in the plan"

    def _exchange(self, request: _Request) -> tuple[Any, float]:
        """The first answer of the right unit, function and length, and when the request was sent."""
        from pymodbus.exceptions import ConnectionException, ModbusException

        transport = self._opened()
        transport.discard()
        sent = time.monotonic()
        try:
            answer = request.send(transport.client)
        except ModbusException as error:
            if isinstance(error, ConnectionException):
                transport.close()
                raise Closed from error
            self._miss(sent)
            raise _NoAnswer(f"gave no valid answer as unit {self._options.device_id} (is device_id right?)") from error
        except Exception as error:  # of a port that is lost, or closed by another thread, pymodbus and pyserial raise whatever they meet
            transport.close()
            raise Closed from error
        if answer.function_code & 0x7F != request.function or not (answer.isError() or request.fits(answer)):
            self._miss(sent)
            raise _NoAnswer("sent the answer to another request")
        return answer, sent

    def _miss(self, sent: float) -> None:
        """An answer is outstanding: a connection is closed with it, a line brings it later."""
        if self._options.host is None:
            self._unanswered.append(sent)
        elif self._transport is not None:
            self._transport.close()

    def _settle(self) -> None:
        """Let late answers come and go."""
        if not self._unanswered or self._hurry.is_set():
            return
        quiet_s, longest_s = _QUIET * self._options.timeout_s, _LONGEST * self._options.timeout_s
        came, silent = self._opened().wait_for_silence(quiet_s, longest_s, 0.0, self._hurry)
        if not silent:
            raise _NoAnswer("does not fall silent (does another program ask on this line?)")
        del self._unanswered[:came]

    def _second_answer(self, sent: float) -> bool:
        """Whether the answer just had was that to an earlier request, so that another one follows.

        That one would come as late after its request as the first came after the oldest one that was not answered.
        """
        quiet_s, longest_s = _QUIET * self._options.timeout_s, _LONGEST * self._options.timeout_s
        delay_s = min(time.monotonic() - self._unanswered[0], longest_s)
        self._unanswered = []
        came, _ = self._opened().wait_for_silence(quiet_s, longest_s, sent + delay_s + quiet_s, self._hurry)
        return came > 0

    def _restore(self) -> None:
        """Connect and identify again where the far end has closed the connection. Raises DeviceTimeout, IdentityError."""
        transport = self._opened()
        try:
            transport.discard()
        except Closed:
            transport.close()
            try:
                self._connect(transport)
            except IdentityError:
                raise
            except ConnectError as error:
                raise DeviceTimeout(f"{self.name} was lost and takes no new connection: {error}") from error

    def _connect(self, transport: Transport) -> None:
        transport.open()
        try:
            if transport is not self._transport:  # closed meanwhile, by another thread
                raise ConnectError(f"{self._device} was closed")
            if self._options.identity is not None:
                self._identify(transport, self._options.identity)
        except BaseException:
            transport.close()
            raise

    def _identify(self, transport: Transport, identity: Identity) -> None:
        request, why = self._reading(identity.where), ""
        for _ in range(self._options.retries + 1):
            try:
                if not transport.is_open:
                    transport.open()
                value = _value(identity.where, self._accepted(request))
                break
            except _NoAnswer as error:
                why = f"it {error}"
            except Closed:
                why = "it broke the connection"
            except DeviceFault as error:
                why = str(error)
        else:
            raise IdentityError(f"{self.name} cannot be identified: {why}")
        if abs(value - identity.equals) > 1e-6 * max(abs(identity.equals), 1.0):
            raise IdentityError(f"{self.name} identifies itself as {value:g}, not as {identity.equals:g}; is this the right box?")

    def _opened(self) -> Transport:
        if self._transport is None:
            raise ConnectError(f"{self._device} is not connected")
        return self._transport


def _value(register: Register, answer: Any) -> float:
    return register.decode(list(answer.bits if register.is_bit else answer.registers))
