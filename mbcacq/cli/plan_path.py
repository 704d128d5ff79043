"""The argument that names a plan: a file, or one of the tool's own by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from mbcacq.cli.terminal import echo


class PlanPath(click.Path):
    """A path; ``kuka`` or ``plans/kuka.yaml`` becomes the plan that came with the tool, where there is no such file."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        from mbcacq.model import shipped

        path = super().convert(value, param, ctx)
        assert isinstance(path, Path), "path_type asks for it"
        found = shipped.plan_file(path)
        if found != path:
            echo(f"there is no {path} here: this is the plan that came with mbcacq; mbcacq plan copy {found.stem} puts it here", err=True)
        return found
