"""The argument that names a plan: a file, or one of the tool's own by its name."""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click

from mbcacq.cli.terminal import echo
from mbcacq.errors import ConfigError
from mbcacq.model import shipped


class PlanPath(click.Path):
    """A path; ``kuka`` or ``plans/kuka.yaml`` is the plan that came with the tool if there is no such file,
    and ``kuka`` is the user's own ``kuka.yaml`` where that lies here."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = super().convert(value, param, ctx)
        assert isinstance(path, Path), "path_type asks for it"
        is_path = str(value).startswith((f".{os.sep}", "./", ".."))  # pathlib drops the dot
        mine = path.with_suffix(".yaml")
        if not is_path and len(path.parts) == 1 and not path.exists() and mine.is_file():
            echo(f"{path} is {mine}, which lies here", err=True)
            return mine
        found = path if is_path else shipped.plan_file(path)
        if found != path:
            echo(f"there is no {path} here: this is the plan that came with mbcacq; mbcacq plan copy {found.stem} puts it here", err=True)
        if not found.exists() and is_path and path.suffix == "":
            named = f"; the plan that came with mbcacq is {path.stem}, without './'" if path.stem in shipped.plans() else ""
            raise ConfigError(f"there is no file {value}{named or '; give the path of a plan'}")
        if not found.exists() and (meant := _near(found)) is not None:
            raise ConfigError(f"there is no plan {path}; did you mean {meant}?")
        return found


def _near(missing: Path) -> Path | None:
    """The plan that is called almost the same: in the folder of the one that is missing, or of those that came with the tool."""
    beside = {file.stem: file for file in missing.parent.glob("*.yaml")} if missing.parent.is_dir() else {}
    named = {name: Path(name) for name in shipped.plans()} | beside
    return next((named[name] for name in get_close_matches(missing.stem, named, 1, 0.7)), None)
