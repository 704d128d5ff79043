"""The options of the EKI driver, checked. deg, mm, kg at this edge, as on the wire."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mbcacq.devices import ConfigError, is_host
from mbcacq_kuka.controller_flags import COUNT, FIRST, LARGEST
from mbcacq_kuka.option_values import array, check_limits, check_numbers, check_positive, output_numbers, refuse_unknown

MODES = {"T1": 1, "T2": 2, "AUT": 3, "EXT": 4}
_RANGES = {
    "port": (1, 65535, True),
    "acceleration_percent": (1, 100, True),
    "path_speed_mm_s": (1, 3000, False),
    "tool": (0, 128, True),
    "base": (0, 128, True),
    "override": (1, 100, True),
    "load_kg": (0, 5000, False),
    "flange_tolerance_mm": (1e-6, 1e6, False),
    "connect_timeout_s": (1e-3, 1e6, False),
    "silence_s": (1e-2, 1e3, False),
    "reconnect_s": (0, 1e4, False),
    "beat_ms": (1, 1e4, False),
    "controller_silence_ms": (100, 10000, True),
    "state_ms": (12, 1000, True),
    "first_flag": (1, LARGEST - COUNT + 1, True),
}


@dataclass(frozen=True, kw_only=True)
class EkiOptions:
    """Everything a plan may say about the EKI connection, and the cell it expects at the other end.

    address, port: the controller. limits_deg: (6, 2) joint limits. speed_deg_s: (6,) the controller's joint speeds at 100 %.
    acceleration_percent: of the controller's own; EKI moves know no other measure. path_speed_mm_s: the fastest LIN.

    tool, base: numbers that the program on the controller selects. tool_frame, base_frame: X, Y, Z, A, B, C they must have, or None.
    mode: 'T1', 'T2', 'AUT', 'EXT', several of them, or 'any'. override: $OV_PRO in percent, or None. load_kg: mass that the controller
    counts with, or None. kinematics: six rows (sign, theta_deg, d_mm, a_mm, alpha_deg, beta_deg) of the nominal arm, against
    which the controller's own Cartesian position is checked, or None; flange_tolerance_mm: by so much it may differ.

    connect_timeout_s: how long to wait for the controller and its program. silence_s: without a state that long is a fault.
    reconnect_s: how long to try to get a lost connection back while the arm stands; 0 never. beat_ms: robot time between our signs of
    life. controller_silence_ms, state_ms: written into the controller's program: how long it bears our silence before it brakes,
    and how often it tells its state. first_flag: number of the first of five $FLAGs that the program uses.

    follow: of the plan's robot section: a person, or another program, moves the arm. Only the link program in the submit interpreter is
    needed then, and only signs of life are sent to it.

    digital_outputs: numbers n of the outputs $OUT[n] that may be switched from here, as to trigger a scanner; they are written into the
    controller's program.
    """

    address: str
    limits_deg: tuple[tuple[float, float], ...]
    speed_deg_s: tuple[float, ...]
    port: int = 54610
    acceleration_percent: int = 50
    path_speed_mm_s: float = 250.0
    tool: int = 1
    base: int = 0
    tool_frame: tuple[float, ...] | None = None
    base_frame: tuple[float, ...] | None = None
    mode: tuple[str, ...] = ("any",)
    override: int | None = 100
    load_kg: float | None = None
    kinematics: tuple[tuple[float, ...], ...] | None = None
    flange_tolerance_mm: float = 1.0
    connect_timeout_s: float = 30.0
    silence_s: float = 1.0
    reconnect_s: float = 5.0
    beat_ms: float = 96.0
    controller_silence_ms: int = 1000
    state_ms: int = 24
    first_flag: int = FIRST
    follow: bool = False
    digital_outputs: tuple[int, ...] = ()

    @property
    def modes(self) -> frozenset[int]:
        """$MODE_OP as the controller numbers it; all if any will do."""
        return frozenset(MODES.values()) if "any" in self.mode else frozenset(MODES[m] for m in self.mode)


def read_options(name: str, given: Mapping[str, Any]) -> EkiOptions:
    """Raises ConfigError for an unknown option or a value that cannot be."""
    refuse_unknown(name, given, [f.name for f in fields(EkiOptions)])
    options = EkiOptions(**_converted(name, given))
    check_numbers(name, options, _RANGES)
    check_positive(name, "speed_deg_s", options.speed_deg_s)
    check_limits(name, options.limits_deg)
    if 2.0 * options.beat_ms > options.controller_silence_ms:
        raise ConfigError(f"robot '{name}': beat_ms must be less than half of controller_silence_ms, or the controller brakes by itself")
    return options


def _converted(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Lists as tuples of floats, one mode as a tuple of one."""
    values = dict(given)
    if not isinstance(values.get("address"), str) or not values["address"].strip():
        raise ConfigError(f"robot '{name}': option address is missing; give the controller's IP address")
    if not is_host(values["address"].strip()):
        raise ConfigError(
            f"robot '{name}': option address must be a host name or an IP address, such as 172.31.1.147, not {values['address']!r}"
        )
    for key, what in (("limits_deg", "joint limits, six pairs in °"), ("speed_deg_s", "the axes' largest speeds, °/s")):
        if values.get(key) is None:
            raise ConfigError(f"robot '{name}': option {key} ({what}) is missing, and the robot file does not say it either")
    for key, shape in (("limits_deg", (6, 2)), ("kinematics", (6, 6))):
        if values.get(key) is not None:
            values[key] = tuple(map(tuple, array(name, key, values[key], shape).tolist()))
    for key in ("speed_deg_s", "tool_frame", "base_frame"):
        if values.get(key) is not None:
            values[key] = tuple(array(name, key, values[key], (6,)).tolist())
    values["digital_outputs"] = output_numbers(name, values)
    if "mode" in values:
        values["mode"] = _modes(name, values["mode"])
    return values


def _modes(name: str, mode: Any) -> tuple[str, ...]:
    modes = tuple(map(str, mode)) if isinstance(mode, list | tuple) else (str(mode),)
    if not modes or not set(modes) <= {*MODES, "any"}:
        raise ConfigError(f"robot '{name}': option mode must be any, T1, T2, AUT or EXT, it is {mode!r}")
    return modes
