"""Where a Modbus device is, and how it is identified, as a plan gives it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from mbcacq.devices import HOST, DriverOptions
from mbcacq_bus.registers import Register


class Identity(DriverOptions):
    """A register that must hold a certain value, so that the wrong box is noticed before anything moves."""

    where: Register
    equals: float


class Connection(DriverOptions):
    """Either ``host`` (Modbus TCP) or ``serial`` (RTU: a device name, or socket://host:port for a serial server).

    idle_poll_s: a connection that nobody has used for so long is read once, since many controllers close an idle one; 0 for never.
    """

    host: str | None = Field(default=None, pattern=HOST)
    port: int = Field(default=502, ge=1, le=65535)
    serial: str | None = None
    baudrate: int = 19200
    parity: Literal["N", "E", "O"] = "E"
    stopbits: Literal[1, 2] = 1
    device_id: int = Field(default=1, ge=0, le=247)
    timeout_s: float = Field(default=1.0, gt=0)
    retries: int = Field(default=2, ge=0)
    idle_poll_s: float = Field(default=2.0, ge=0)
    identity: Identity | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Connection:
        if (self.host is None) == (self.serial is None):
            raise ValueError("give either host or serial")
        return self

    @property
    def address(self) -> str:
        return f"{self.host}:{self.port}" if self.host else str(self.serial)

    @property
    def has_connection(self) -> bool:
        """Whether there is a connection that the far end can close."""
        return self.host is not None or "://" in str(self.serial)
