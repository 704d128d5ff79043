"""The argument that names a run: a path, or ``latest`` for the newest run in the folder ``runs``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


class RunPath(click.Path):
    """A path; 'latest' and 'runs/latest' become the folder of the newest run."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        from mbcacq.files.atomic_write import INCOMPLETE, finish_set
        from mbcacq.recording.run_folder.latest import named_run

        path = super().convert(value, param, ctx)
        assert isinstance(path, Path), "path_type asks for it"
        run = named_run(path)
        folder = run if run.is_dir() else run.parent
        if (folder / INCOMPLETE).exists():
            finish_set(folder)
        return run
