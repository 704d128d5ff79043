"""The driver's options as a plan gives them, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mbcacq.devices import ConfigError

MODES = ("snapshot", "trigger")


@dataclass(frozen=True)
class Options:
    """address: host name or IPv4. job: '' keeps the loaded one. timeout_s: longest wait for a scan. reply_limit_s: caps the
    protocol's own time limit of every command. retries: attempts after a dropped connection.
    """

    address: str
    control_port: int = 3190
    health_port: int = 3194
    data_port: int = 3196
    job: str = ""
    mode: str = "snapshot"
    exposure_us: float | None = None
    timeout_s: float = 10.0
    connect_timeout_s: float = 3.0
    reply_limit_s: float | None = None
    retries: int = 2

    @classmethod
    def read(cls, name: str, given: Mapping[str, Any]) -> Options:
        """Raises ConfigError naming the option that is wrong."""
        known = [f.name for f in fields(cls)]
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise ConfigError(f"scanner '{name}': unknown option '{unknown[0]}' (known: {', '.join(known)})")
        if not isinstance(given.get("address"), str) or not given["address"].strip():
            raise ConfigError(f"scanner '{name}': the option address is missing; give the Gocator's IP address (192.168.1.10 as delivered)")
        for key in ("control_port", "health_port", "data_port"):
            _number(name, given, key, int, 1, 65535)
        for key in ("exposure_us", "timeout_s", "connect_timeout_s", "reply_limit_s"):
            _number(name, given, key, (int, float), 1e-3, 1e7)
        _number(name, given, "retries", int, 0, 10)
        if not isinstance(given.get("job", ""), str):
            raise ConfigError(f"scanner '{name}': job must be the name of a job stored on the sensor, not {given['job']!r}")
        if given.get("mode", MODES[0]) not in MODES:
            raise ConfigError(f"scanner '{name}': mode must be one of {', '.join(MODES)}, not {given['mode']!r}")
        return cls(**given)


def _number(name: str, given: Mapping[str, Any], key: str, kind: Any, low: float, high: float) -> None:
    value = given.get(key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high):
        raise ConfigError(f"scanner '{name}': {key} must be a number from {low:g} to {high:g}, not {value!r}")
    if value is None and key in given and key not in ("exposure_us", "reply_limit_s"):
        raise ConfigError(f"scanner '{name}': {key} must not be empty")
