"""The options of the RSI driver, checked. deg at this edge, as on the wire."""

from __future__ import annotations

import ipaddress
from typing import Any, Literal

from pydantic import Field, model_validator

from mbcacq.devices import is_loopback
from mbcacq_kuka.option_values import KukaOptions, OneOrSix
from mbcacq_kuka.rsi.telegram import Composer

_LONGEST = 1e6
FASTEST_DEG_S = 800.0  # of an axis whose largest speed is not given: faster than any of KUKA's
_FASTEST_START_S, _FASTEST_RISE_S = 0.05, 0.005  # to full speed, to full acceleration, where these are not given


class RsiOptions(KukaOptions):
    """Everything a plan may say about the RSI connection.

    bind, port: where this computer listens (the IP_NUMBER and PORT of the RSI Ethernet configuration). controller_ip: accept only this
    sender; must be given unless bind is a loopback address. cycle_ms: 4 (#IPO_FAST) or 12 (#IPO). sen_type, correction, stop_element:
    names agreed in the Ethernet configuration; stop_element '' if there is none. stop_at_close: end the KRL program's RSI_MOVECORR on
    close. external_axes: the Ethernet configuration that is written for the controller sends E1 to E6, too.

    speed_deg_s, acceleration_deg_s2, jerk_deg_s3: (6,) what the axes may do at most; no set point
    beyond them is sent. Without them the axes are taken for very fast ones. correction_limit_deg: largest correction of each axis
    the controller allows, one number or six, or None if the KRL program opens the full range (ours does).

    late_limit: answers the controller may discard within late_window_s of its clock (0: within the session). ride_out_s: a gap in the
    telegrams of up to this length is taken for the network's; after a longer one the controller is expected to have ended its session.
    follow_tolerance_deg, follow_cycles, follow_lag_s: the arm may leave the band of the commands of the last follow_lag_s by so much
    for so long. check_set_point: refuse to start on a controller that already applies a correction. cpu: processor core of the
    cycle process; None: any.

    follow: every answer is then a correction of zero, and the session is never ended from here. The others: see KukaOptions.
    """

    bind: str = "127.0.0.1"
    port: int = Field(default=49152, ge=0, le=65535, strict=True)
    controller_ip: str = ""
    cycle_ms: Literal[4, 12] = 4
    sen_type: str = "ImFree"
    correction: str = "AK"
    stop_element: str = "Stop"
    stop_at_close: bool = Field(default=True, strict=True)
    external_axes: bool = Field(default=False, strict=True)
    speed_deg_s: OneOrSix | None = None
    acceleration_deg_s2: OneOrSix | None = None
    jerk_deg_s3: OneOrSix | None = None
    correction_limit_deg: OneOrSix | None = None
    late_limit: int = Field(default=90, ge=1, le=1_000_000_000, strict=True)
    late_window_s: float = Field(default=1.0, ge=0, le=_LONGEST, strict=True)
    ride_out_s: float = Field(default=0.3, ge=0.012, le=10, strict=True)
    follow_tolerance_deg: float = Field(default=0.5, ge=1e-6, le=360, strict=True)
    follow_cycles: int = Field(default=25, ge=1, le=100_000, strict=True)
    follow_lag_s: float = Field(default=0.1, ge=0.012, le=2, strict=True)
    check_set_point: bool = Field(default=True, strict=True)
    cpu: int | None = Field(default=None, ge=0, le=4095, strict=True)

    @model_validator(mode="after")
    def _fits(self) -> RsiOptions:
        Composer(self.sen_type, self.correction, self.stop_element)
        for key, address in (("bind", self.bind), ("controller_ip", self.controller_ip)):
            if address and not _is_address(address):
                raise ValueError(f"{key} must be an IP address, such as 172.31.1.100, it is {address!r}; the telegrams go to no name")
        if not self.controller_ip and not is_loopback(self.bind):
            raise ValueError(
                f"controller_ip is missing; on {self.bind} any computer of the network could send telegrams, so "
                "give the address of the controller's RSI interface"
            )
        return self

    def settings(self) -> dict[str, Any]:
        """Settings of the cycle process, all numbers resolved."""
        not_ours = {"check_set_point": False, "stop_at_close": False} if self.follow else {}
        return {**self.model_dump(), **not_ours, "dynamics": self.dynamics}

    @property
    def dynamics(self) -> tuple[list[float], list[float], list[float]]:
        """Largest speed, acceleration and jerk of each axis: deg/s, deg/s^2, deg/s^3."""
        speed = self.speed_deg_s or (FASTEST_DEG_S,) * 6
        acceleration = self.acceleration_deg_s2 or tuple(v / _FASTEST_START_S for v in speed)
        jerk = self.jerk_deg_s3 or tuple(a / _FASTEST_RISE_S for a in acceleration)
        return list(speed), list(acceleration), list(jerk)


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return text == "localhost"
    return True
