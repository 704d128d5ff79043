"""The options of a driver as a plan gives them: the base of their pydantic models, and what is wrong with them as one sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from mbcacq.errors import ConfigError

Options = TypeVar("Options", bound=BaseModel)
ONE_SIDED = {"gt": "above", "ge": "of at least", "lt": "below", "le": "of at most"}
MOST = {"s": 1e6, "kg": 5000.0, "deg": 36_000.0}  # by the unit in an option's name: 12 days, what the largest arms carry, 100 turns
MOST_OF_ALL = 1e10  # serial numbers have 32 bits


class DriverOptions(BaseModel):
    """Base of every driver's options: an unknown option, NaN, infinity, a number that no device has and a text in its place are refused,
    and nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=())

    @field_validator("*", mode="before")
    @classmethod
    def _a_number(cls, value: Any, info: ValidationInfo) -> Any:
        name = str(info.field_name)
        if isinstance(value, str | bool) and _kind(cls.model_fields[name]) in (int, float):
            raise PydanticCustomError("number", "Input should be a number")
        most = MOST.get(name.rpartition("_")[2], MOST_OF_ALL)
        if beyond := [number for number in _numbers(value) if abs(number) > most]:
            raise ValueError(f"{beyond[0]:g} is beyond {most:g}, the most that any device has")
        return value


def _numbers(value: Any) -> Iterator[float]:
    """Those in a value of an option."""
    if isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _numbers(part)
    elif isinstance(value, int | float):
        yield value


def parse_options(schema: type[Options], device: str, options: Mapping[str, Any], hidden: tuple[str, ...] = ()) -> Options:
    """Options of ``device`` ('robot 'arm'') checked by ``schema``. hidden: those that the program hands over, not the plan.

    Raises ConfigError naming the option and what is wrong with it; one that is not known before one that is missing, which is often the
    same one misspelt.
    """
    try:
        return schema.model_validate(dict(options))
    except ValidationError as error:
        found = error.errors()
        first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
        known = ", ".join(name for name in schema.model_fields if name not in hidden)
        raise ConfigError(f"options of {device}: {_fault(schema, first)} (it knows: {known}); correct the plan") from error


def _fault(schema: type[BaseModel], error: Mapping[str, Any]) -> str:
    """What is wrong, in words. error: of pydantic."""
    place, given = error["loc"], error["input"]
    where = ".".join(str(part) for part in place) or "options"
    field = schema.model_fields.get(str(place[0])) if len(place) == 1 else None
    if error["type"] == "extra_forbidden":
        return f"unknown option '{where}'"
    if error["type"] == "missing" or (field is not None and field.is_required() and given in (None, "")):
        return f"{where} is missing{f'; give {field.description}' if field is not None and field.description else ''}"
    if error["type"] == "value_error":  # of a validator of the driver
        return f"{where}: {error['ctx']['error']}" if place else str(error["ctx"]["error"])
    if given is None:
        return f"{where} must not be empty"
    wanted = "" if field is None else _wanted(field)
    return f"{where} must be {wanted}, not {given!r}" if wanted else f"{where}: {error['msg']}, not {given!r}"


def _kind(field: FieldInfo) -> Any:
    """Its type where it has a value."""
    kind: Any = field.annotation
    return next(one for one in get_args(kind) if one is not NoneType) if get_origin(kind) in (Union, UnionType) else kind


def _wanted(field: FieldInfo) -> str:
    """What a value should be, '' if it is neither a number nor a choice nor a text."""
    kind = _kind(field)
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    if kind in (int, float):
        return f"a {'whole ' if kind is int else ''}number{_bounds(field)}"
    return {bool: "true or false", str: "a text"}.get(kind, "")


def _bounds(field: FieldInfo) -> str:
    """In which range a number must be."""
    bounds = {name: float(getattr(one, name)) for one in field.metadata for name in ONE_SIDED if getattr(one, name, None) is not None}
    if set(bounds) == {"ge", "le"}:
        return f" from {bounds['ge']:g} to {bounds['le']:g}"
    return "".join(f" {ONE_SIDED[name]} {bound:g}" for name, bound in bounds.items())
