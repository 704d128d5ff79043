"""Options of the OPC UA driver, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from mbcacq.devices import HOST, DriverOptions


class OpcUaOptions(DriverOptions):
    """address, port, path: of the server. user, password_env: who logs in, and the environment variable that holds the password.
    security: as asyncua writes it, such as ``Basic256Sha256,SignAndEncrypt,cert.pem,key.pem``; None: without.

    arm: which motion device, where the server has several. axes: browse names in the order of the robot file; None: its rotary axes in
    the order of their names. angle_unit: where the server states none. expect_model: words of its Model. payload_kg: what its
    flange load must be. rate_hz: how often it is read. silence_s: without an answer for so long it counts as lost.

    limits_deg, speed_deg_s, follow, controller_matrix (n, n), controller_offset_deg (n,): from the plan.
    """

    address: str = Field(min_length=1, pattern=HOST)
    port: int = Field(default=4840, ge=1, le=65535)
    path: str = ""
    user: str | None = None
    password_env: str | None = None
    security: str | None = None
    arm: str | None = None
    axes: tuple[str, ...] | None = None
    angle_unit: Literal["deg", "rad"] | None = None
    expect_model: str | None = None
    payload_kg: float | None = Field(default=None, ge=0)
    payload_tolerance_kg: float = Field(default=0.1, gt=0)
    rate_hz: float = Field(default=20.0, ge=1, le=200)
    connect_timeout_s: float = Field(default=10.0, gt=0)
    silence_s: float = Field(default=3.0, gt=0)
    limits_deg: tuple[tuple[float, float], ...] = Field(min_length=1)
    speed_deg_s: tuple[float, ...] | None = None
    follow: bool = True
    controller_matrix: tuple[tuple[float, ...], ...] | None = None
    controller_offset_deg: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _fits(self) -> OpcUaOptions:
        if self.axes is not None and len(self.axes) != len(self.limits_deg):
            raise ValueError(f"axes names {len(self.axes)} axes of an arm that has {len(self.limits_deg)}")
        if self.password_env is not None and self.user is None:
            raise ValueError("password_env needs a user")
        return self

    @property
    def url(self) -> str:
        return f"opc.tcp://{self.address}:{self.port}/{self.path.lstrip('/')}"
