"""The driver's options as a plan gives them, checked before anything is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mbcacq.devices import ConfigError
from mbcacq_gocator.option_checks import PORT, SensorOptions, check, flag, one_of, text

MODES = ("snapshot", "trigger")
BRACKETS = ("merge", "best")
_MAX_BRACKET, _MAX_PASSWORD = 16, 63
CHECKS = {
    "health_port": PORT,
    "job": text("the name of a job stored on the sensor"),
    "job_file": text("the path of a job file"),
    "replace_job": flag,
    "mode": one_of(MODES),
    "bracket": one_of(BRACKETS),
}


@dataclass(frozen=True, kw_only=True)
class GocatorOptions(SensorOptions):
    """job_file: a file to store on the sensor as ``job`` (default: its own name) first. exposures_us: all of them at every capture, made
    into one scan as ``bracket`` says. password: of the sensor's administrator, where its security is on; "$NAME" takes that environment
    variable, so that no plan need hold it. The others: see SensorOptions.
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
        check(name, cls, given, CHECKS)
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


def _exposures(name: str, value: Any) -> tuple[float, ...]:
    right = (
        isinstance(value, list | tuple)
        and len(value) <= _MAX_BRACKET
        and all(isinstance(v, int | float) and not isinstance(v, bool) and 1e-3 <= v <= 1e7 for v in value)
    )
    if not right or len(set(value)) != len(value):
        raise ConfigError(f"scanner '{name}': exposures_us must be a list of up to {_MAX_BRACKET} different exposures in us, not {value!r}")
    return tuple(map(float, value))
