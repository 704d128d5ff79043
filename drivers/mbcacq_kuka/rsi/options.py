"""The options of the RSI driver, checked. deg at this edge, as on the wire."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError
from mbcacq_kuka.option_values import array, check_limits, check_numbers, check_positive, output_numbers, refuse_unknown
from mbcacq_kuka.rsi.telegram import Composer

KUKA_SERVER = {"sen_type": "KROSHU", "port": 59152}  # what the RSI programs of KUKA's EKI server are configured for
_LONGEST = 1e6
FASTEST_DEG_S = 800.0  # of an axis whose largest speed is not given: faster than any of KUKA's
_FASTEST_START_S, _FASTEST_RISE_S = 0.05, 0.005  # to full speed, to full acceleration, where these are not given
_PER_AXIS = ("speed_deg_s", "acceleration_deg_s2", "jerk_deg_s3", "correction_limit_deg")
_RANGES = {
    "port": (0, 65535, True),
    "late_limit": (1, 1_000_000_000, True),
    "follow_cycles": (1, 100_000, True),
    "cpu": (0, 4095, True),
    "late_window_s": (0.0, _LONGEST, False),
    "ride_out_s": (0.012, 10.0, False),
    "recover_s": (0.0, _LONGEST, False),
    "follow_lag_s": (0.012, 2.0, False),
    "connect_timeout_s": (1e-3, _LONGEST, False),
    "silence_s": (1e-2, 1e4, False),
    "follow_tolerance_deg": (1e-6, 360.0, False),
}


@dataclass(frozen=True, kw_only=True)
class RsiOptions:
    """Everything a plan may say about the RSI connection.

    bind, port: where this computer listens (the IP_NUMBER and PORT of the RSI Ethernet configuration). controller_ip: accept only this
    sender; must be given unless bind is a loopback address. cycle_ms: 4 (#IPO_FAST) or 12 (#IPO). sen_type, correction, stop_element:
    names agreed in the Ethernet configuration; stop_element '' if there is none. stop_at_close: end the KRL program's RSI_MOVECORR on
    close. external_axes: the Ethernet configuration that is written for the controller sends E1 to E6, too.

    limits_deg: (6, 2) joint limits. speed_deg_s, acceleration_deg_s2, jerk_deg_s3: (6,) what the axes may do at most; no set point
    beyond them is sent. Without them the axes are taken for very fast ones. correction_limit_deg: largest correction of each axis
    the controller allows, one number or six, or None if the KRL program opens the full range (ours does).

    eki: 'host' or 'host:port' of KUKA's EKI server program, to check the robot's model, switch the drives on and start RSI; '' if the
    operator starts the RSI program by hand.

    connect_timeout_s: how long to wait for the controller. silence_s: without a telegram that long is a fault. late_limit: answers
    the controller may discard within late_window_s of its clock (0: within the session). ride_out_s: a gap in the telegrams of up to
    this length is taken for the network's; after a longer one the controller is expected to have ended its session.
    recover_s: after the controller fell silent, as after an emergency stop, wait so long for its program to be started again, and go
    on; 0: end the run.

    follow_tolerance_deg, follow_cycles, follow_lag_s: the arm may leave the band of the commands of the last follow_lag_s by so much
    for so long. check_set_point: refuse to start on a controller that already applies a correction. cpu: processor core of the
    cycle process; None: any.

    follow: of the plan's robot section: another program, or a person, moves the arm. Every answer is then a correction of zero, and the
    session is never ended from here.

    digital_outputs: numbers n of the outputs $OUT[n] that may be switched from here, as to trigger a scanner.
    """

    limits_deg: tuple[tuple[float, float], ...]
    bind: str = "127.0.0.1"
    port: int = 49152
    controller_ip: str = ""
    cycle_ms: int = 4
    sen_type: str = "ImFree"
    correction: str = "AK"
    stop_element: str = "Stop"
    stop_at_close: bool = True
    external_axes: bool = False
    eki: str = ""
    speed_deg_s: tuple[float, ...] | None = None
    acceleration_deg_s2: tuple[float, ...] | None = None
    jerk_deg_s3: tuple[float, ...] | None = None
    correction_limit_deg: tuple[float, ...] | None = None
    connect_timeout_s: float = 30.0
    silence_s: float = 1.0
    late_limit: int = 90
    late_window_s: float = 1.0
    ride_out_s: float = 0.3
    recover_s: float = 0.0
    follow_tolerance_deg: float = 0.5
    follow_cycles: int = 25
    follow_lag_s: float = 0.1
    check_set_point: bool = True
    cpu: int | None = None
    follow: bool = False
    digital_outputs: tuple[int, ...] = ()

    def settings(self) -> dict[str, Any]:
        """Settings of the cycle process, all numbers resolved."""
        not_ours = {"check_set_point": False, "stop_at_close": False} if self.follow else {}
        return {**asdict(self), **not_ours, "dynamics": self.dynamics}

    @property
    def dynamics(self) -> tuple[list[float], list[float], list[float]]:
        """Largest speed, acceleration and jerk of each axis: deg/s, deg/s^2, deg/s^3."""
        speed = self.speed_deg_s or (FASTEST_DEG_S,) * 6
        acceleration = self.acceleration_deg_s2 or tuple(v / _FASTEST_START_S for v in speed)
        jerk = self.jerk_deg_s3 or tuple(a / _FASTEST_RISE_S for a in acceleration)
        return list(speed), list(acceleration), list(jerk)


def read_options(name: str, given: Mapping[str, Any]) -> RsiOptions:
    """Raises ConfigError for an unknown option or a value that cannot be."""
    refuse_unknown(name, given, [f.name for f in fields(RsiOptions)])
    if given.get("limits_deg") is None:
        raise ConfigError(f"robot '{name}': option limits_deg (joint limits, six pairs in °) is missing")
    values = {**(KUKA_SERVER if given.get("eki") else {}), **given}
    values["limits_deg"] = tuple((float(low), float(high)) for low, high in array(name, "limits_deg", given["limits_deg"], (6, 2)))
    for key in _PER_AXIS:
        if values.get(key) is not None:
            values[key] = _one_or_six(name, key, values[key])
    values["digital_outputs"] = output_numbers(name, values)
    options = RsiOptions(**values)
    check_numbers(name, options, _RANGES)
    check_limits(name, options.limits_deg)
    for key in _PER_AXIS:
        check_positive(name, key, getattr(options, key))
    _check_texts(name, options)
    _check_addresses(name, options)
    if options.cycle_ms not in (4, 12):
        raise ConfigError(f"robot '{name}': option cycle_ms must be 4 or 12, it is {options.cycle_ms!r}")
    if options.eki and options.recover_s:
        raise ConfigError(
            f"robot '{name}': options eki and recover_s exclude each other: after an emergency stop a person must start the RSI program; "
            "leave one of them out"
        )
    return options


def on_loopback(address: str) -> bool:
    """Whether only programs on this computer can send to a socket that is bound to ``address``."""
    try:
        return address == "localhost" or ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return text == "localhost"
    return True


def _one_or_six(name: str, key: str, value: Any) -> tuple[float, ...]:
    six = [value] * 6 if np.ndim(value) == 0 else value
    return tuple(array(name, key, six, (6,)).tolist())


def _check_texts(name: str, options: RsiOptions) -> None:
    try:
        Composer(options.sen_type, options.correction, options.stop_element)
    except ValueError as error:
        raise ConfigError(f"robot '{name}': options sen_type, correction, stop_element: {error}") from error
    if not re.fullmatch(r"(?:[^:\s]+(?::\d{1,5})?)?", options.eki):
        raise ConfigError(f"robot '{name}': option eki must be 'host' or 'host:port', it is {options.eki!r}")


def _check_addresses(name: str, options: RsiOptions) -> None:
    if not isinstance(options.bind, str) or not isinstance(options.controller_ip, str):
        raise ConfigError(f"robot '{name}': options bind and controller_ip are addresses, in quotes")
    for key, address in (("bind", options.bind), ("controller_ip", options.controller_ip)):
        if address and not _is_address(address):
            raise ConfigError(
                f"robot '{name}': option {key} must be an IP address, such as 172.31.1.100, it is {address!r}; the telegrams go to no name"
            )
    if not options.controller_ip and not on_loopback(options.bind):
        raise ConfigError(
            f"robot '{name}': option controller_ip is missing; on {options.bind} any computer of the network could send telegrams, so "
            "give the address of the controller's RSI interface"
        )
