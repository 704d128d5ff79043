"""The options of the EKI driver, checked. deg, mm, kg at this edge, as on the wire."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator

from mbcacq.devices import HOST, DriverOptions
from mbcacq_kuka.controller_flags import COUNT, FIRST, LARGEST
from mbcacq_kuka.eki.telegrams import AXES
from mbcacq_kuka.option_values import KukaOptions, PositiveSix, Six

MODES = {"T1": 1, "T2": 2, "AUT": 3, "EXT": 4}


def mode_name(mode: int) -> str:
    """How the smartPAD calls an operating mode."""
    return next((name for name, number in MODES.items() if number == mode), f"unknown ({mode})")


def _modes(mode: Any) -> tuple[str, ...]:
    """One mode, or several."""
    modes = tuple(map(str, mode)) if isinstance(mode, list | tuple) else (str(mode),)
    if not modes or not set(modes) <= {*MODES, "any"}:
        raise ValueError(f"mode must be any, T1, T2, AUT or EXT, it is {mode!r}")
    return modes


class ExternalAxis(DriverOptions):
    """An axis of the controller beside the arm, in deg, or mm where it slides. carries_arm: a track, a lift, a gantry."""

    name: str = Field(pattern="^E[1-6]$")
    slides: bool
    carries_arm: bool
    limits: tuple[float, float]
    speed: float = Field(gt=0)


class EkiOptions(KukaOptions):
    """Everything a plan may say about the EKI connection, and the cell it expects at the other end.

    address, port: the controller. speed_deg_s: (6,) the controller's joint speeds at 100 %.
    acceleration_percent: of the controller's own; EKI moves know no other measure.

    tool, base: numbers that the program on the controller selects. tool_frame, base_frame: X, Y, Z, A, B, C they must have, or None.
    mode: 'T1', 'T2', 'AUT', 'EXT', several of them, or 'any'. override: $OV_PRO in percent, or None. load_kg: mass that the controller
    counts with, or None. kinematics: six rows (sign, theta_deg, d_mm, a_mm, alpha_deg, beta_deg) of the nominal arm, against
    which the controller's own Cartesian position is checked, or None; flange_tolerance_mm: by so much it may differ.

    connect_timeout_s: how long to wait for the controller and its program. reconnect_s: how long to try to get a lost connection back while
    the arm stands; 0 never. beat_ms: robot time between our signs of life. controller_silence_ms, state_ms: written into the controller's
    program: how long it bears our silence before it brakes, and how often it tells its state. first_flag: number of the first of five
    $FLAGs that the program uses.

    external_axes: of the plan, in the order in which it counts them, before the axes of the arm. Telegrams have them behind these.

    follow: only the link program in the submit interpreter is needed then, and only signs of life are sent to it. digital_outputs: they
    are written into the controller's program. The others: see KukaOptions.
    """

    address: str = Field(min_length=1, pattern=HOST, description="the controller's host name or IP address, such as 172.31.1.147")
    speed_deg_s: PositiveSix = Field(description="the axes' largest speeds, °/s, if the robot file does not have them")
    port: int = Field(default=54610, ge=1, le=65535, strict=True)
    acceleration_percent: int = Field(default=50, ge=1, le=100, strict=True)
    tool: int = Field(default=1, ge=0, le=128, strict=True)
    base: int = Field(default=0, ge=0, le=128, strict=True)
    tool_frame: Six | None = None
    base_frame: Six | None = None
    mode: Annotated[tuple[str, ...], BeforeValidator(_modes)] = ("any",)
    override: int | None = Field(default=100, ge=1, le=100, strict=True)
    load_kg: float | None = Field(default=None, ge=0, le=5000, strict=True)
    kinematics: tuple[Six, ...] | None = Field(default=None, min_length=6, max_length=6)
    flange_tolerance_mm: float = Field(default=1.0, ge=1e-6, le=1e6, strict=True)
    reconnect_s: float = Field(default=5.0, ge=0, le=1e4, strict=True)
    beat_ms: float = Field(default=96.0, ge=1, le=1e4, strict=True)
    controller_silence_ms: int = Field(default=1000, ge=100, le=10000, strict=True)
    state_ms: int = Field(default=24, ge=12, le=1000, strict=True)
    external_axes: tuple[ExternalAxis, ...] = ()
    first_flag: int = Field(default=FIRST, ge=1, le=LARGEST - COUNT + 1, strict=True)

    @model_validator(mode="after")
    def _beats_in_time(self) -> EkiOptions:
        if 2.0 * self.beat_ms > self.controller_silence_ms:
            raise ValueError("beat_ms must be less than half of controller_silence_ms, or the controller brakes by itself")
        return self

    @property
    def axes(self) -> tuple[str, ...]:
        """(n,) names in the order of the telegrams."""
        return (*AXES, *sorted(axis.name for axis in self.external_axes))

    @property
    def limits(self) -> np.ndarray:
        """(n, 2) deg or mm, in the order of the telegrams."""
        own = dict(zip(AXES, self.limits_deg, strict=True)) | {axis.name: axis.limits for axis in self.external_axes}
        return np.array([own[name] for name in self.axes])

    @property
    def speeds(self) -> np.ndarray:
        """(n,) deg/s or mm/s at 100 %, in the order of the telegrams."""
        own = dict(zip(AXES, self.speed_deg_s, strict=True)) | {axis.name: axis.speed for axis in self.external_axes}
        return np.array([own[name] for name in self.axes])

    def in_telegram(self, values: np.ndarray) -> np.ndarray:
        """(n,) as telegrams have them, of positions or speeds (n,) in the order of the plan, in rad or mm."""
        return (values * self._factor)[self._at]

    def in_plan(self, values: ArrayLike) -> np.ndarray:
        """Positions (.., n) in the order of the plan, in rad or mm, of those in a telegram."""
        return np.asarray(values, dtype=float)[..., np.argsort(self._at)] / self._factor

    @property
    def _factor(self) -> np.ndarray:
        return np.array([*(1.0 if axis.slides else np.degrees(1.0) for axis in self.external_axes), *(np.degrees(1.0),) * len(AXES)])

    @property
    def _at(self) -> np.ndarray:
        """(n,) where the plan has each axis of a telegram."""
        plan = (*(axis.name for axis in self.external_axes), *AXES)
        return np.array([plan.index(name) for name in self.axes])

    @property
    def modes(self) -> frozenset[int]:
        """$MODE_OP as the controller numbers it; all if any will do."""
        return frozenset(MODES.values()) if "any" in self.mode else frozenset(MODES[m] for m in self.mode)
