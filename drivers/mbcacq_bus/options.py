"""Driver options as pydantic models, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from mbcacq.devices import ConfigError


class BusOptions(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


AnyOptions = TypeVar("AnyOptions", bound=BusOptions)


def parse(schema: type[AnyOptions], device: str, options: Mapping[str, Any]) -> AnyOptions:
    """Raises ConfigError naming the device, the option and what is wrong with it."""
    try:
        return schema.model_validate(dict(options))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "options"
        known = ", ".join(schema.model_fields)
        raise ConfigError(f"options of {device}: {where}: {first['msg']} (it knows: {known}); correct the plan") from error
