"""What a file with effects must hold: keys, kinds, shapes, and every index within the arm that the effects were learnt on.

It is checked once, where it is read: an index beyond the arm would end a calibration, and a negative one would displace another joint.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, WithJsonSchema

from mbcacq.effects.functions import FUNCTIONS
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import first_fault

COMPONENTS = {"joint": 1, "frame": 6, "station": 6, "point": 3, "orientation": 3, "ball": 3}  # of each place
_LOCATION = re.compile(r"^(?:A|link)([0-9]+)$")
_OF_JOINT = re.compile(r"^(?:q|qd|tau|direction_|movement_|gravity_torque_|payload_torque_)([0-9]+)(?:_(?:mass|x|y|z))?$")
_OF_FRAME = re.compile(r"^gravity_(?:moment|direction)_([0-9]+)_[xyz]$")
PLACE = (
    "what is displaced: joint (rad), frame (local twist mm, rad; 0 behind the base, i behind link i), point (mm in the scanner frame), "
    "ball (mm in the artefact frame), station (local twist), orientation (rad about the target's own axes)"
)
Three = tuple[float, float, float]


class _Open(BaseModel):
    """Further keys are allowed; numbers are finite."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class FunctionInFile(_Open):
    of: str = Field(description="name of a covariate")
    kind: Annotated[str, WithJsonSchema({"enum": list(FUNCTIONS)})]
    numbers: list[float]


class ProductInFile(_Open):
    factor: float
    functions: list[FunctionInFile]


class PartInFile(_Open):
    place: Annotated[str, WithJsonSchema({"enum": list(COMPONENTS)})] = Field(description=PLACE)
    index: int
    component: int
    columns: list[list[ProductInFile]]


class RangeInFile(_Open):
    intervals: list[tuple[float, float]] = Field(min_length=1)
    mean: float


class TermInFile(_Open):
    name: str = Field(min_length=1)
    where: list[str]
    depends_on: str
    variant: str
    hyper: dict[str, float]
    parts: list[PartInFile] = Field(min_length=1)
    names: list[str] = Field(min_length=1)
    units: list[str]
    coefficients: list[float]
    std: list[float | None]
    sigma: list[float | None]
    typical: list[float | None]
    ranges: dict[str, RangeInFile]
    clamped: list[str]
    held: bool = False


class RobotInFile(_Open):
    model_config = ConfigDict(extra="allow", allow_inf_nan=True)  # an axis may turn without end

    name: str
    sign: list[Literal[-1, 1]] = Field(min_length=1)
    nominal: dict[Literal["theta", "d", "a", "alpha", "beta"], list[float]] = Field(min_length=5)
    limits: list[tuple[float | None, float | None]]
    mass_kg: list[float]
    com_mm: list[Three]
    payload_mass_kg: float
    payload_com_mm: Three
    gravity: Three


class AnchorInFile(_Open):
    pose: int
    q: list[float]


class LearntInFile(_Open):
    anchors: list[AnchorInFile]
    poses: list[int]
    time_origin_s: float
    duration_s: float


class EffectModelFile(_Open):
    measurement: Literal["artefact_in_scanner", "target_in_base"]
    robot: RobotInFile
    learnt: LearntInFile
    terms: list[TermInFile]


def check_effects(content: Mapping[str, Any], source: str, key: str = "") -> None:
    """Refuse content of a model of effects that is damaged. source: how a message calls the file; key: under which the model is in it.

    Raises ConfigError with the key of the fault.
    """
    within = f"{key}." if key else ""
    try:
        model = EffectModelFile.model_validate(dict(content))
    except ValidationError as error:
        at, fault = first_fault(error)
        raise _damaged(source, within + at, fault) from None
    robot, axes = model.robot, len(model.robot.sign)
    of_axes = {"limits": robot.limits, "mass_kg": robot.mass_kg, "com_mm": robot.com_mm}
    for name, values in {**of_axes, **{f"nominal.{p}": column for p, column in robot.nominal.items()}}.items():
        if len(values) != axes:
            raise _damaged(source, f"{within}robot.{name}", f"{len(values)} values for {axes} axes")
    for i, term in enumerate(model.terms):
        _check_term(term, axes, source, f"{within}terms.{i}")


def _check_term(term: TermInFile, axes: int, source: str, key: str) -> None:
    k = len(term.names)
    for name in ("units", "coefficients", "std", "sigma", "typical"):
        if len(getattr(term, name)) != k:
            raise _damaged(source, f"{key}.{name}", f"{len(getattr(term, name))} values for {k} coefficients")
    for j, s in enumerate(term.sigma):
        if s is not None and s <= 0:
            raise _damaged(source, f"{key}.sigma.{j}", f"{s:g} is no standard deviation: it must be larger than zero, or null for none")
    for j, place in enumerate(term.where):
        found = _LOCATION.match(place)
        if found and not 1 <= int(found[1]) <= axes:
            raise _damaged(source, f"{key}.where.{j}", f"there is no {place} on an arm of {axes} axes")
    for j, part in enumerate(term.parts):
        _check_part(part, k, axes, source, f"{key}.parts.{j}")


def _check_part(part: PartInFile, k: int, axes: int, source: str, key: str) -> None:
    if part.place not in COMPONENTS:
        raise _damaged(source, f"{key}.place", f"'{part.place}' is none of {', '.join(COMPONENTS)}")
    last = {"joint": axes - 1, "frame": axes}.get(part.place)  # the others have no index
    if last is not None and not 0 <= part.index <= last:
        raise _damaged(source, f"{key}.index", f"{part.index} is not within 0 to {last}, as a {part.place} of an arm of {axes} axes is")
    if not 0 <= part.component < COMPONENTS[part.place]:
        raise _damaged(source, f"{key}.component", f"{part.component} is not within 0 to {COMPONENTS[part.place] - 1}")
    if len(part.columns) != k:
        raise _damaged(source, f"{key}.columns", f"{len(part.columns)} columns for {k} coefficients")
    for c, column in enumerate(part.columns):
        for p, product in enumerate(column):
            for f, function in enumerate(product.functions):
                _check_function(function, axes, source, f"{key}.columns.{c}.{p}.functions.{f}")


def _check_function(function: FunctionInFile, axes: int, source: str, key: str) -> None:
    for pattern, first in ((_OF_JOINT, 1), (_OF_FRAME, 0)):
        found = pattern.match(function.of)
        if found and not first <= int(found[1]) <= axes:
            raise _damaged(source, f"{key}.of", f"there is no {function.of} on an arm of {axes} axes")
    kind = FUNCTIONS.get(function.kind)
    if kind is None:
        raise ConfigError(f"{source}: {key}.kind: there is no function '{function.kind}'; where a newer mbcacq wrote it, update this one")
    count = kind.__code__.co_argcount - 1
    if len(function.numbers) != count:
        raise _damaged(source, f"{key}.numbers", f"'{function.kind}' has {count} numbers, here are {len(function.numbers)}")
    with np.errstate(all="ignore"):
        at_zero, beside = kind(np.array([0.0, 0.5]), *function.numbers)
        if np.isnan(at_zero) or not np.isfinite(beside):  # a width of zero, say; a power may have a pole
            raise _damaged(source, f"{key}.numbers", f"with these '{function.kind}' has no finite value")


def _damaged(source: str, key: str, fault: str) -> ConfigError:
    return ConfigError(f"{source}: {key}: {fault}; the model of effects is damaged, make it anew with mbcacq diagnose")
