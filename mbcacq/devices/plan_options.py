"""The options of a driver as a plan gives them, checked by its pydantic model: what is wrong is one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from mbcacq.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import BaseModel

Options = TypeVar("Options", bound="BaseModel")


def parse_options(schema: type[Options], device: str, options: Mapping[str, Any], hidden: tuple[str, ...] = ()) -> Options:
    """Options of ``device`` ('robot 'arm'') checked by ``schema``. hidden: those that the program hands over, not the plan.

    Raises ConfigError naming the option and what is wrong with it; one that is not known before one that is missing, which is often the
    same one misspelt.
    """
    from pydantic import ValidationError

    try:
        return schema.model_validate(dict(options))
    except ValidationError as error:
        found = error.errors()
        first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
        where = ".".join(str(part) for part in first["loc"]) or "options"
        wrong = f"unknown option '{where}'" if first["type"] == "extra_forbidden" else f"{where}: {first['msg']}"
        known = ", ".join(name for name in schema.model_fields if name not in hidden)
        raise ConfigError(f"options of {device}: {wrong} (it knows: {known}); correct the plan") from error
