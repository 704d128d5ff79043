"""The argument that names a run: a path, or ``latest`` for the newest run in the folder ``runs``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from mbcacq.errors import ConfigError, command_line, nearest
from mbcacq.files import atomic_write
from mbcacq.recording.run_folder import latest, register
from mbcacq.report.sources import run_folder
from mbcacq.workflow import load


class RunPath(click.Path):
    """A path; 'latest' and 'runs/latest' become the folder of the newest recording of the kinds that the command can use.

    kinds: of ``RunKind`` by name; default all that can be calibrated by themselves. checks_too: the folder of a check is accepted where it
    is named, though 'latest' is none. every_kind: whatever was recorded.
    """

    def __init__(self, *kinds: str, checks_too: bool = False, every_kind: bool = False) -> None:
        super().__init__(path_type=Path)
        self._kinds, self._checks_too, self._every_kind = kinds, checks_too, every_kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = super().convert(value, param, ctx)
        assert isinstance(path, Path), "path_type asks for it"
        kinds = frozenset(register.RunKind if self._every_kind else map(register.RunKind, self._kinds)) or register.CALIBRATED_FROM
        run = latest.named_run(path, kinds)
        if not os.path.lexists(run) and (meant := nearest(run.name, ["latest", *(one.name for one in run.parent.glob("*"))])):
            raise ConfigError(f"{run} does not exist{meant}")
        register.refuse_other_kind(run, kinds | {register.RunKind.CHECK} if self._checks_too else kinds)
        folder = run if run.is_dir() else run.parent
        if (folder / atomic_write.INCOMPLETE).exists():
            atomic_write.finish_set(folder)
        return run


def judge_first(result: Path) -> tuple[str, str]:
    """What to do before something that a result made is relied upon, and the command for it. result: a run folder with one, the folder of
    its result with effects, or a result.json."""
    run = folder_of(result)
    if run is None:
        return "judge it by further poses, and anew after any work on the cell", command_line("verify", result, "OTHER")
    return "see first how far the result is to be trusted, and where", command_line("report", run)


def folder_of(result: Path) -> Path | None:
    """The folder that a report of a result can be made of; None for a result.json that lies by itself."""
    folder = result if result.is_dir() else result.parent
    if folder.name == run_folder.WITH_EFFECTS and (folder.parent / "result.json").exists():
        folder = folder.parent
    return folder if result.is_dir() or load.is_run_folder(folder) else None
