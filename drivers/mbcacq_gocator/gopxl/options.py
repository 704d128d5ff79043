"""The options of driver ``gopxl`` as a plan gives them, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mbcacq.devices import ConfigError, is_host
from mbcacq_gocator.snapshot_options import SnapshotOptions

_TEXTS = ("address", "job", "source", "broadcast")
_FLAGS = ("uniform", "right_handed", "allow_aligned", "restore")
_PORTS = {"control_port": 1, "data_port": 0, "discovery_port": 1, "discovery_listen_port": 0}
_NUMBERS = {
    "exposure_us": (1e-3, 1e7),
    "timeout_s": (1e-3, 1e4),
    "connect_timeout_s": (1e-3, 1e3),
    "reply_limit_s": (1e-3, 1e3),
    "grace_s": (0.0, 1e4),
    "temperature_warning_C": (-50.0, 150.0),
    "temperature_stop_C": (-50.0, 150.0),
}


@dataclass(frozen=True, kw_only=True)
class GoPxLOptions(SnapshotOptions):
    """data_port: 0 takes the one that the sensor names. source: id of the data source, '' for the scanner's own surface. uniform: a height
    map instead of a point cloud. right_handed: turn x of the sensor's left-handed frame round. The others: see SnapshotOptions.
    """

    control_port: int = 3600
    data_port: int = 0
    source: str = ""
    uniform: bool = False
    right_handed: bool = True
    discovery_port: int = 3320
    discovery_listen_port: int = 3320

    @classmethod
    def read(cls, name: str, given: Mapping[str, Any]) -> GoPxLOptions:
        """Raises ConfigError naming the option that is wrong."""
        known = {f.name: f.default for f in fields(cls)}
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise ConfigError(f"scanner '{name}': unknown option '{unknown[0]}' (known: {', '.join(known)})")
        for key, value in given.items():
            if value is None and known[key] is None:
                continue
            problem = _problem(key, value)
            if problem:
                raise ConfigError(f"scanner '{name}': {key} must be {problem}, not {value!r}")
        if not str(given.get("address", "")).strip() and given.get("serial") is None:
            raise ConfigError(
                f"scanner '{name}': the option address is missing; give the sensor's IP address "
                "(192.168.1.10 as delivered), or its serial number to have it looked for"
            )
        return cls(**given)


def _problem(key: str, value: Any) -> str:
    """What a value should be instead, '' where it is right."""
    if key in _TEXTS:
        text = value.strip() if isinstance(value, str) else None
        if text and key in ("address", "broadcast") and not is_host(text):
            return "a host name or an IP address, such as 192.168.1.10"
        return "a text" if text is None else ""
    if key in _FLAGS:
        return "" if isinstance(value, bool) else "true or false"
    if key in _NUMBERS:
        low, high = _NUMBERS[key]
        kind: type[int] | tuple[type[int], type[float]] = (int, float)
    else:
        low, high = (_PORTS[key], 65535) if key in _PORTS else (0, 10) if key == "retries" else (1, 2**32 - 1)
        kind = int
    right = isinstance(value, int | float) and isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high
    return "" if right else f"a number from {low:g} to {high:g}"
