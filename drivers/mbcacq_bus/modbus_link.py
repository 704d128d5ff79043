"""A Modbus connection, TCP or serial RTU: pymodbus with named errors, one call at a time."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from pydantic import Field, model_validator

from mbcacq.devices import ConnectError, DeviceFault, DeviceTimeout, IdentityError, ProtocolError
from mbcacq_bus.options import BusOptions
from mbcacq_bus.registers import Register

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # its failures reach the user as our errors, once

REASONS = {
    1: "the function is not supported",
    2: "there is no such address",
    3: "the value is not allowed",
    4: "the device failed",
    6: "the device is busy",
}


class Identity(BusOptions):
    """A register that must hold a certain value, so that the wrong box is noticed before anything moves."""

    where: Register
    equals: float


class Connection(BusOptions):
    """Either ``host`` (Modbus TCP) or ``serial`` (RTU: a device name, or socket://host:port for a serial server)."""

    host: str | None = None
    port: int = Field(default=502, ge=1, le=65535)
    serial: str | None = None
    baudrate: int = 19200
    parity: Literal["N", "E", "O"] = "E"
    stopbits: Literal[1, 2] = 1
    device_id: int = Field(default=1, ge=0, le=247)
    timeout_s: float = Field(default=1.0, gt=0)
    retries: int = Field(default=2, ge=0)
    identity: Identity | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Connection:
        if (self.host is None) == (self.serial is None):
            raise ValueError("give either host or serial")
        return self

    @property
    def address(self) -> str:
        return f"{self.host}:{self.port}" if self.host else str(self.serial)


class ModbusLink:
    """Reads and writes ``Register`` values. Raises ConnectError, DeviceTimeout, DeviceFault, ProtocolError."""

    def __init__(self, device: str, options: Connection) -> None:
        self._device, self._options = device, options
        self._lock = threading.Lock()
        self._client: Any = None

    @property
    def connected(self) -> bool:
        return self._client is not None

    def open(self) -> None:
        """Connect and identify."""
        from pymodbus.client import ModbusSerialClient, ModbusTcpClient
        from pymodbus.exceptions import ModbusException

        o = self._options
        common: dict[str, Any] = {"timeout": o.timeout_s, "retries": o.retries}
        client = (
            ModbusTcpClient(o.host, port=o.port, **common)
            if o.host
            else ModbusSerialClient(str(o.serial), baudrate=o.baudrate, parity=o.parity, stopbits=o.stopbits, **common)
        )
        try:
            reached = client.connect()
        except (ModbusException, OSError, ValueError) as error:
            raise ConnectError(f"{self._device} at {o.address} cannot be reached: {error}; check address and cable") from error
        if not reached:
            client.close()
            raise ConnectError(f"{self._device} does not answer at {o.address}; is it on, and is the address right?")
        self._client = client
        if o.identity is not None:
            self._identify(o.identity)

    def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):
                client.close()

    def read(self, register: Register) -> float:
        c, n = self._client, register.count
        call = {
            "holding": lambda: c.read_holding_registers(register.address, count=n, device_id=self._options.device_id),
            "input": lambda: c.read_input_registers(register.address, count=n, device_id=self._options.device_id),
            "coil": lambda: c.read_coils(register.address, count=n, device_id=self._options.device_id),
            "discrete": lambda: c.read_discrete_inputs(register.address, count=n, device_id=self._options.device_id),
        }[register.table]
        answer = self._ask(call, f"reading {register.table} {register.address}")
        words = list(answer.bits if register.is_bit else answer.registers)
        if len(words) < n:
            raise ProtocolError(f"{self._device} sent {len(words)} of {n} values for {register.table} {register.address}")
        return register.decode(words)

    def write(self, register: Register, value: float) -> None:
        where = f"writing {register.table} {register.address}"
        if register.table == "coil":
            self._ask(lambda: self._client.write_coil(register.address, bool(value), device_id=self._options.device_id), where)
        else:
            words = register.encode(value)
            self._ask(lambda: self._client.write_registers(register.address, words, device_id=self._options.device_id), where)

    def _ask(self, call: Callable[[], Any], what: str) -> Any:
        from pymodbus.exceptions import ConnectionException, ModbusException

        if self._client is None:
            raise ConnectError(f"{self._device} is not connected")
        try:
            with self._lock:
                answer = call()
        except ConnectionException as error:
            raise DeviceTimeout(f"{self._device} at {self._options.address} broke the connection while {what}") from error
        except ModbusException as error:
            raise DeviceTimeout(f"{self._device} at {self._options.address} gave no valid answer while {what}: {error}") from error
        except OSError as error:
            raise DeviceTimeout(f"{self._device} at {self._options.address} was lost while {what}: {error}") from error
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            reason = REASONS.get(code, f"exception code {code}")
            raise DeviceFault(f"{self._device} refused {what}: {reason}; check the registers in the plan")
        return answer

    def _identify(self, identity: Identity) -> None:
        try:
            value = self.read(identity.where)
        except (DeviceTimeout, DeviceFault, ProtocolError) as error:
            self.close()
            raise IdentityError(f"{self._device} at {self._options.address} cannot be identified: {error}") from error
        if abs(value - identity.equals) > 1e-6 * max(abs(identity.equals), 1.0):
            self.close()
            raise IdentityError(
                f"{self._device} at {self._options.address} identifies itself as {value:g}, "
                f"not as {identity.equals:g}; is this the right box?"
            )
