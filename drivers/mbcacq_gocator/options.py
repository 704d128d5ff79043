"""The options of driver ``gocator`` as a plan gives them, checked before anything is opened."""

from __future__ import annotations

import os
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from mbcacq_gocator.snapshot_options import SnapshotOptions

_MAX_BRACKET, _MAX_PASSWORD = 16, 63


def _password(given: Any) -> str:
    """Errors do not show it."""
    found = given
    if isinstance(given, str) and given.startswith("$"):
        found = os.environ.get(given[1:])
        if found is None:
            raise ValueError(f"the environment variable {given[1:]} that shall hold it is not set")
    if not isinstance(found, str) or len(found.encode()) > _MAX_PASSWORD:
        raise ValueError(f"it must be a text of up to {_MAX_PASSWORD} bytes, or $ and the name of an environment variable")
    return found


def _exposures(value: Any) -> tuple[float, ...]:
    right = (
        isinstance(value, list | tuple)
        and len(value) <= _MAX_BRACKET
        and all(isinstance(v, int | float) and not isinstance(v, bool) and 1e-3 <= v <= 1e7 for v in value)
    )
    if not right or len(set(value)) != len(value):
        raise ValueError(f"it must be a list of up to {_MAX_BRACKET} different exposures in us, not {value!r}")
    return tuple(map(float, value))


class GocatorOptions(SnapshotOptions):
    """exposures_us: all of them at every capture, made
    into one scan as ``bracket`` says. mode: profile streams the profiles of a line scanner, as its job triggers them. password: of the
    sensor's administrator, where its security is on; "$NAME" takes that environment variable, so that no plan need hold it. The others: see
    SnapshotOptions.
    """

    sensor: ClassVar[str] = "Gocator"

    control_port: int = Field(default=3190, ge=1, le=65535, strict=True)
    health_port: int = Field(default=3194, ge=1, le=65535, strict=True)
    data_port: int = Field(default=3196, ge=1, le=65535, strict=True)
    mode: Literal["snapshot", "trigger", "profile"] = "snapshot"
    exposures_us: Annotated[tuple[float, ...], BeforeValidator(_exposures)] = ()
    bracket: Literal["merge", "best"] = "merge"
    password: Annotated[str, BeforeValidator(_password)] = Field(default="", repr=False)
    discovery_port: int = Field(default=3220, ge=1, le=65535, strict=True)

    @model_validator(mode="after")
    def _one_kind_of_exposure(self) -> GocatorOptions:
        if self.exposures_us and self.exposure_us is not None:
            raise ValueError("give either exposure_us or exposures_us, not both")
        return self
