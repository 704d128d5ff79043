"""Text files that are written from a template beside the module that fills it in (Jinja)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


def filled(template: Path, /, **values: Any) -> str:
    """The text of a template with its values, line feeds at the ends of its lines.

    A template has the filters of Jinja, and ``decimals(places=1)``, which never writes a negative zero. Values are escaped in templates of
    HTML and SVG. Raises jinja2.UndefinedError for a value that is not given.
    """
    return environment_of(template.parent).get_template(template.name).render(values)


@cache
def environment_of(folder: Path) -> Environment:
    """One for each folder: it keeps the templates that it has compiled."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=select_autoescape(("html.j2", "svg.j2")),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["decimals"] = _decimals
    return environment


def _decimals(value: float, places: int = 1) -> str:
    return f"{value + 0.0:.{places}f}"
