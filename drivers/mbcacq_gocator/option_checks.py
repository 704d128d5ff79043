"""Options as a plan gives them, checked one by one before anything is opened: for the sensors of both generations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from mbcacq.devices import ConfigError, is_host

Check = Callable[[Any], str]  # what a value should be instead, '' where it is right


def number(low: float, high: float, kind: type[int] | tuple[type[int], type[float]] = (int, float)) -> Check:
    """kind: int for whole numbers alone."""

    def check(value: Any) -> str:
        right = isinstance(value, int | float) and isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high
        return "" if right else f"a number from {low:g} to {high:g}"

    return check


def text(what: str = "a text") -> Check:
    return lambda value: "" if isinstance(value, str) else what


def one_of(choices: tuple[str, ...]) -> Check:
    return lambda value: "" if value in choices else f"one of {', '.join(choices)}"


def flag(value: Any) -> str:
    return "" if isinstance(value, bool) else "true or false"


def host(value: Any) -> str:
    """'' is one too: whether an address is needed, other options decide."""
    if not isinstance(value, str):
        return "a text"
    return "" if not value.strip() or is_host(value.strip()) else "a host name or an IP address, such as 192.168.1.10"


@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """address: host name or IPv4; '' looks for the sensor with ``serial`` by broadcast. job: '' keeps the loaded one. allow_aligned: accept
    points that are not in the sensor's own coordinates. timeout_s: longest wait for a scan. reply_limit_s: caps the protocol's own time
    limit of every request. grace_s: added to all of them, for a sensor that a busy computer plays. retries: attempts after a dropped
    connection.
    """

    address: str = ""
    serial: int | None = None
    job: str = ""
    exposure_us: float | None = None
    temperature_warning_C: float | None = None
    temperature_stop_C: float | None = None
    allow_aligned: bool = False
    restore: bool = True
    timeout_s: float = 10.0
    connect_timeout_s: float = 3.0
    reply_limit_s: float | None = None
    grace_s: float = 0.0
    retries: int = 2
    broadcast: str = "255.255.255.255"


WHOLE = int
PORT = number(1, 65535, WHOLE)
CELSIUS = number(-50, 150)
SHARED: Mapping[str, Check] = {
    "address": host,
    "broadcast": host,
    "serial": number(1, 2**32 - 1, WHOLE),
    "control_port": PORT,
    "data_port": PORT,
    "discovery_port": PORT,
    "exposure_us": number(1e-3, 1e7),
    "temperature_warning_C": CELSIUS,
    "temperature_stop_C": CELSIUS,
    "allow_aligned": flag,
    "restore": flag,
    "timeout_s": number(1e-3, 1e7),
    "connect_timeout_s": number(1e-3, 1e7),
    "reply_limit_s": number(1e-3, 1e7),
    "grace_s": number(0, 1e4),
    "retries": number(0, 10, WHOLE),
}


def check(name: str, options: type[SensorOptions], given: Mapping[str, Any], own: Mapping[str, Check]) -> None:
    """Raises ConfigError naming the option that is wrong. own: the checks that the sensors do not share."""
    defaults, checks = {f.name: f.default for f in fields(options)}, {**SHARED, **own}
    if unknown := sorted(set(given) - set(defaults)):
        raise ConfigError(f"scanner '{name}': unknown option '{unknown[0]}' (known: {', '.join(defaults)})")
    for key, value in given.items():
        if value is None and key in checks:
            if defaults[key] is not None:
                raise ConfigError(f"scanner '{name}': {key} must not be empty")
        elif key in checks and (problem := checks[key](value)):
            raise ConfigError(f"scanner '{name}': {key} must be {problem}, not {value!r}")
    if not given.get("address", "").strip() and given.get("serial") is None:
        raise ConfigError(
            f"scanner '{name}': the option address is missing; give the sensor's IP address "
            "(192.168.1.10 as delivered), or its serial number to have it looked for"
        )
