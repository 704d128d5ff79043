"""Text files that are written from a template beside the module that fills it in (Jinja)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


def filled(template: Path, /, **values: Any) -> str:
    """The text of a template with its values, line feeds at the ends of its lines.

    A template also has the filters ``decimals(places)``, which never writes a negative zero, and those of Jinja. Raises
    jinja2.UndefinedError for a value that is not given.
    """
    return _environment(template.parent).get_template(template.name).render(values)


@cache
def _environment(folder: Path) -> Environment:
    """One for each folder: it keeps the templates that it has compiled."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(folder), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters["decimals"] = _decimals
    return environment


def _decimals(value: float, places: int) -> str:
    return f"{value + 0.0:.{places}f}"
