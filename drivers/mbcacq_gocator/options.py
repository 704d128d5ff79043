"""The driver's options as a plan gives them, checked before anything is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from mbcacq.devices import ConfigError, is_host
from mbcacq_gocator.snapshot_options import SnapshotOptions

MODES = ("snapshot", "trigger")
BRACKETS = ("merge", "best")
_MAX_BRACKET, _MAX_PASSWORD = 16, 63


@dataclass(frozen=True, kw_only=True)
class GocatorOptions(SnapshotOptions):
    """job_file: a file to store on the sensor as ``job`` (default: its own name) first. exposures_us: all of them at every capture, made
    into one scan as ``bracket`` says. password: of the sensor's administrator, where its security is on; "$NAME" takes that environment
    variable, so that no plan need hold it. The others: see SnapshotOptions.
    """

    control_port: int = 3190
    health_port: int = 3194
    data_port: int = 3196
    job_file: str = ""
    replace_job: bool = False
    mode: str = "snapshot"
    exposures_us: tuple[float, ...] = ()
    bracket: str = "merge"
    password: str = field(default="", repr=False)
    discovery_port: int = 3220

    @classmethod
    def read(cls, name: str, given: Mapping[str, Any]) -> GocatorOptions:
        """Raises ConfigError naming the option that is wrong."""
        known = [f.name for f in fields(cls)]
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise ConfigError(f"scanner '{name}': unknown option '{unknown[0]}' (known: {', '.join(known)})")
        for key in ("address", "job", "job_file", "broadcast"):
            _text(name, given, key)
        if not given.get("address", "").strip() and given.get("serial") is None:
            raise ConfigError(
                f"scanner '{name}': the option address is missing; give the Gocator's IP address "
                "(192.168.1.10 as delivered), or its serial number to have it looked for"
            )
        for key in ("control_port", "health_port", "data_port", "discovery_port"):
            _number(name, given, key, int, 1, 65535)
        for key in ("exposure_us", "timeout_s", "connect_timeout_s", "reply_limit_s"):
            _number(name, given, key, (int, float), 1e-3, 1e7)
        for key in ("temperature_warning_C", "temperature_stop_C"):
            _number(name, given, key, (int, float), -50, 150)
        _number(name, given, "grace_s", (int, float), 0, 1e4)
        _number(name, given, "retries", int, 0, 10)
        _number(name, given, "serial", int, 1, 2**32 - 1)
        _one_of(name, given, "mode", MODES)
        _one_of(name, given, "bracket", BRACKETS)
        for key in ("replace_job", "allow_aligned", "restore"):
            if not isinstance(given.get(key, False), bool):
                raise ConfigError(f"scanner '{name}': {key} must be true or false, not {given[key]!r}")
        exposures = _exposures(name, given.get("exposures_us", ()))
        if exposures and given.get("exposure_us") is not None:
            raise ConfigError(f"scanner '{name}': give either exposure_us or exposures_us, not both")
        return cls(**{**given, "exposures_us": exposures, "password": _password(name, given.get("password", ""))})


def _password(name: str, given: Any) -> str:
    """Errors do not show it."""
    found = given
    if isinstance(given, str) and given.startswith("$"):
        found = os.environ.get(given[1:])
        if found is None:
            raise ConfigError(f"scanner '{name}': the environment variable {given[1:]} that shall hold the password is not set")
    if not isinstance(found, str) or len(found.encode()) > _MAX_PASSWORD:
        raise ConfigError(
            f"scanner '{name}': password must be a text of up to {_MAX_PASSWORD} bytes, or $ and the name of an environment variable"
        )
    return found


def _text(name: str, given: Mapping[str, Any], key: str) -> None:
    if not isinstance(given.get(key, ""), str):
        kind = {"job": "the name of a job stored on the sensor", "job_file": "the path of a job file"}.get(key, "an address")
        raise ConfigError(f"scanner '{name}': {key} must be {kind}, not {given[key]!r}")
    if key in ("address", "broadcast") and given.get(key, "").strip() and not is_host(given[key].strip()):
        raise ConfigError(f"scanner '{name}': option {key} must be a host name or an IP address, such as 192.168.1.10, not {given[key]!r}")


def _one_of(name: str, given: Mapping[str, Any], key: str, choices: tuple[str, ...]) -> None:
    if given.get(key, choices[0]) not in choices:
        raise ConfigError(f"scanner '{name}': {key} must be one of {', '.join(choices)}, not {given[key]!r}")


def _exposures(name: str, value: Any) -> tuple[float, ...]:
    right = (
        isinstance(value, list | tuple)
        and len(value) <= _MAX_BRACKET
        and all(isinstance(v, int | float) and not isinstance(v, bool) and 1e-3 <= v <= 1e7 for v in value)
    )
    if not right or len(set(value)) != len(value):
        raise ConfigError(f"scanner '{name}': exposures_us must be a list of up to {_MAX_BRACKET} different exposures in us, not {value!r}")
    return tuple(map(float, value))


_MAY_BE_EMPTY = ("exposure_us", "reply_limit_s", "serial", "temperature_warning_C", "temperature_stop_C")


def _number(name: str, given: Mapping[str, Any], key: str, kind: Any, low: float, high: float) -> None:
    value = given.get(key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high):
        raise ConfigError(f"scanner '{name}': {key} must be a number from {low:g} to {high:g}, not {value!r}")
    if value is None and key in given and key not in _MAY_BE_EMPTY:
        raise ConfigError(f"scanner '{name}': {key} must not be empty")
