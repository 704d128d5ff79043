"""The options of the RSI driver, checked. deg at this edge, as on the wire."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError
from mbcacq_kuka.rsi.telegram import Composer


@dataclass(frozen=True)
class RsiOptions:
    """Everything a plan may say about the RSI connection.

    bind, port: where this computer listens (the IP_NUMBER and PORT of the RSI Ethernet configuration). controller_ip: accept
    only this sender. cycle_ms: 4 (#IPO_FAST) or 12 (#IPO). sen_type, correction, stop_element: names agreed in the Ethernet
    configuration; stop_element '' if there is none. stop_at_close: end the KRL program's RSI_MOVECORR on close.

    limits_deg: (6, 2) joint limits. speed_deg_s: (6,) largest joint speeds. correction_limit_deg: largest correction of each axis
    the controller allows, one number or six, or None if the KRL program opens the full range (ours does).

    eki: 'host' or 'host:port' of KUKA's EKI server program, to check the robot's model, switch the drives on and start RSI; '' if the
    operator starts the RSI program by hand.

    connect_timeout_s: how long to wait for the controller. silence_s: without a telegram that long is a fault. late_limit: answers
    the controller may discard. follow_tolerance_deg, follow_cycles: the arm may leave the band of recent commands by so much for so
    long. check_set_point: refuse to start on a controller that already applies a correction.
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
    eki: str = ""
    speed_deg_s: tuple[float, ...] | None = None
    correction_limit_deg: tuple[float, ...] | None = None
    connect_timeout_s: float = 30.0
    silence_s: float = 1.0
    late_limit: int = 60
    follow_tolerance_deg: float = 0.5
    follow_cycles: int = 25
    check_set_point: bool = True

    def settings(self) -> dict[str, Any]:
        return asdict(self)


def read_options(name: str, given: Mapping[str, Any]) -> RsiOptions:
    """Raises ConfigError for an unknown option or a value that cannot be."""
    known = {f.name: f for f in fields(RsiOptions)}
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"robot '{name}': unknown option {', '.join(unknown)}; known are {', '.join(known)}")
    if given.get("limits_deg") is None:
        raise ConfigError(f"robot '{name}': option limits_deg (joint limits, six pairs in deg) is missing")
    values = dict(given)
    values["limits_deg"] = tuple((float(low), float(high)) for low, high in _array(name, "limits_deg", given["limits_deg"], (6, 2)))
    for key in ("speed_deg_s", "correction_limit_deg"):
        if values.get(key) is not None:
            one_or_six = _array(name, key, values[key])
            values[key] = tuple(float(v) for v in (np.full(6, one_or_six) if one_or_six.ndim == 0 else _array(name, key, one_or_six, (6,))))
    options = RsiOptions(**values)
    for key in ("connect_timeout_s", "silence_s", "late_limit", "follow_tolerance_deg", "follow_cycles"):
        if not isinstance(getattr(options, key), int | float) or not getattr(options, key) > 0:
            raise ConfigError(f"robot '{name}': option {key} must be a positive number, it is {getattr(options, key)!r}")
    try:
        Composer(options.sen_type, options.correction, options.stop_element)
    except ValueError as error:
        raise ConfigError(f"robot '{name}': options sen_type, correction, stop_element: {error}") from error
    if options.cycle_ms not in (4, 12):
        raise ConfigError(f"robot '{name}': option cycle_ms must be 4 or 12, it is {options.cycle_ms!r}")
    if not re.fullmatch(r"(?:[^:\s]+(?::\d{1,5})?)?", options.eki):
        raise ConfigError(f"robot '{name}': option eki must be 'host' or 'host:port', it is {options.eki!r}")
    if not isinstance(options.port, int) or not 0 <= options.port < 65536:
        raise ConfigError(f"robot '{name}': option port must be between 0 and 65535, it is {options.port!r}")
    for key in ("speed_deg_s", "correction_limit_deg"):
        if (value := getattr(options, key)) is not None and min(value) <= 0:
            raise ConfigError(f"robot '{name}': option {key} must be positive")
    if any(low >= high for low, high in options.limits_deg):
        raise ConfigError(f"robot '{name}': in limits_deg every lower limit must be below the upper one")
    return options


def _array(name: str, key: str, value: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=float)
        if not np.isfinite(array).all():
            raise ValueError("a value is not finite")
        return array if shape is None else array.reshape(shape)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"robot '{name}': option {key} is wrong: {error}") from error
