"""Options that the sensors of both generations have, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, field_validator, model_validator

from mbcacq.devices import DriverOptions, is_host


class SnapshotOptions(DriverOptions):
    """address: host name or IPv4; '' looks for the sensor with ``serial`` by broadcast. job: '' keeps the loaded one. allow_aligned: accept
    points that are not in the sensor's own coordinates. timeout_s: longest wait for a scan. reply_limit_s: caps the protocol's own time
    limit of every request. grace_s: added to all of them, for a sensor that a busy computer plays.
    """

    sensor: ClassVar[str] = "sensor"  # in sentences

    address: str = ""
    serial: int | None = Field(default=None, ge=1, le=2**32 - 1, strict=True)
    job: str = ""
    exposure_us: float | None = Field(default=None, ge=1e-3, le=1e7, strict=True)
    temperature_warning_C: float | None = Field(default=None, ge=-50, le=150, strict=True)
    temperature_stop_C: float | None = Field(default=None, ge=-50, le=150, strict=True)
    allow_aligned: bool = Field(default=False, strict=True)
    restore: bool = Field(default=True, strict=True)
    timeout_s: float = Field(default=10.0, ge=1e-3, le=1e4, strict=True)
    connect_timeout_s: float = Field(default=3.0, ge=1e-3, le=1e3, strict=True)
    reply_limit_s: float | None = Field(default=None, ge=1e-3, le=1e3, strict=True)
    grace_s: float = Field(default=0.0, ge=0, le=1e4, strict=True)
    broadcast: str = "255.255.255.255"

    @field_validator("address", "broadcast")
    @classmethod
    def _is_host(cls, text: str) -> str:
        if text.strip() and not is_host(text.strip()):
            raise ValueError(f"it must be a host name or an IP address, such as 192.168.1.10, not {text!r}")
        return text

    @model_validator(mode="after")
    def _can_be_found(self) -> SnapshotOptions:
        if not self.address.strip() and self.serial is None:
            raise ValueError(
                f"the option address is missing; give the {self.sensor}'s IP address (192.168.1.10 as delivered), or its serial number to "
                "have it looked for"
            )
        return self
