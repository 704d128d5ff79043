"""What a plan may say under ``fake:``, checked; docs/fakes.md explains each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mbcacq.devices import DriverOptions
from mbcacq.errors import ConfigError
from mbcacq_fakes.world.arm import paper_errors
from mbcacq_fakes.world.environment import Environment

Vector = tuple[float, float, float]
Row = tuple[float, float, float, float, float]


class Frame(DriverOptions):
    rotation: tuple[Vector, Vector, Vector]
    translation_mm: Vector

    def transform(self) -> np.ndarray:
        out = np.eye(4)
        u, _, vt = np.linalg.svd(np.array(self.rotation))
        out[:3, :3], out[:3, 3] = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, self.translation_mm
        return out


class Spread(DriverOptions):
    """Standard deviations of a draw, per axis."""

    mm: float = Field(ge=0)
    deg: float = Field(ge=0)


class InjectedEffectOptions(BaseModel):
    """An injected effect: its name, how strong (1 is plain), its own seed, and whatever else that effect takes."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str
    strength: float = 1.0
    seed: int | None = None


class Mishap(DriverOptions):
    """Something an operator did. from_arrival: only once the arm has come to rest that often."""

    kind: Literal["wrong_artefact", "hidden_ball", "bumped_tripod", "empty_scene"]
    station: str | int | None = None
    artefact: str | None = None
    ball: int | None = None
    shift_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    from_arrival: int = 0


class FakeOptions(DriverOptions):
    errors: Literal["paper", "none", "random"] | tuple[Row, ...] = "paper"
    error_scale: float = 1.0
    repeatability_urad: float = Field(default=5.0, ge=0)
    hand_eye: Frame | None = None
    hand_eye_error: Spread = Spread(mm=1.5, deg=0.4)
    station_error: Spread = Spread(mm=1.5, deg=0.4)
    noise_mm: Vector = (0.005, 0.005, 0.009)
    noise_far_mm: Vector | None = None
    noise_factor_at_60_deg: float = Field(default=1.0, ge=1)
    speckle_mm: float = Field(default=0.012, ge=0)
    pitch_mm: float = Field(default=0.25, gt=0.03)
    furniture: bool = True
    climate: Environment = Environment()
    hidden: tuple[InjectedEffectOptions, ...] = ()
    mishaps: tuple[Mishap, ...] = ()
    draws: Literal["course", "pose"] = "course"  # whether noise follows the course of the run, or belongs to each planned pose
    robot: dict[str, Any] = {}
    scanner: dict[str, Any] = {}
    seed: int | None = None
    noise_seed: int | None = None  # of what differs between two runs of one cell; by default the seed of the cell


SPECKLE_SHARE = 4 / 3  # of a centre's noise along z: the point noise of the scanner that the defaults describe
MOST_PIXELS = 1.5e6  # of a frame, where the plan states no resolution


def of_scanner(scanner: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """``given``, a plan's ``fake:`` section, with what its scanner states of itself where the section is silent.

    scanner: the plan's (read by name): noise_mm, noise_far_mm, noise_factor_at_60_deg, resolution_mm, field_of_view.
    """
    stated: dict[str, Any] = {"noise_factor_at_60_deg": scanner.noise_factor_at_60_deg}
    if scanner.noise_mm is not None:
        stated |= {"noise_mm": scanner.noise_mm, "speckle_mm": SPECKLE_SHARE * float(scanner.noise_mm[2])}
    if scanner.noise_far_mm is not None:
        stated["noise_far_mm"] = scanner.noise_far_mm
    view = scanner.field_of_view
    area = float(np.prod(np.add(view.near_half_mm, view.far_half_mm)))  # mm^2, in the middle
    stated["pitch_mm"] = scanner.resolution_mm or max(0.25, float(np.sqrt(area / MOST_PIXELS)))
    if "noise_mm" in given:
        stated = {name: value for name, value in stated.items() if name == "pitch_mm"}
    return {**stated, **given}


def parse(options: Mapping[str, Any]) -> FakeOptions:
    """Raises ConfigError naming the option."""
    try:
        return FakeOptions.model_validate(dict(options))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"fake.{where}: {first['msg']} (known: {', '.join(FakeOptions.model_fields)}); correct the plan") from error


def arm_errors(options: FakeOptions, n: int, seed: int) -> np.ndarray:
    """(n, 5) errors of the MD-H rows, rad and mm. Raises ConfigError if the table does not fit the arm."""
    if options.errors == "random":
        rng = np.random.default_rng([seed, 99])
        sigma = np.array([np.radians(0.03), 0.15, 0.15, np.radians(0.012), 0.0])
        return options.error_scale * sigma * rng.standard_normal((n, 5))
    out = np.zeros((n, 5))
    if options.errors == "none":
        return out
    if options.errors == "paper":
        table = paper_errors()
    else:
        table = np.array(options.errors, dtype=float)
        table[:, [0, 3, 4]] = np.radians(table[:, [0, 3, 4]])
        if len(table) != n:
            raise ConfigError(f"fake.errors has {len(table)} rows, but the arm has {n} axes; give one row an axis")
    out[: min(n, len(table))] = table[:n]
    return options.error_scale * out
