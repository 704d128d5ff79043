"""Which run is meant: ``latest`` beside the folders of the runs is a link to the newest one, or a file with its name where links are not
possible; a plan is none."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import inside_folder

RUNS, LATEST = "runs", "latest"


def mark_latest(folder: Path) -> None:
    """Let ``latest`` name this folder of a run, if it stands in a folder 'runs'. Anything else of that name stays; so does a run whose mark
    cannot be written."""
    folder = folder.absolute()
    mark = folder.parent / LATEST
    if folder.parent.name != RUNS or folder == mark or mark.is_dir() and not mark.is_symlink():
        return
    made = mark.with_name(f".{LATEST}-{os.getpid()}")  # replaced in one step: two runs may start at once
    with suppress(OSError):
        try:
            made.symlink_to(folder.name, target_is_directory=True)
        except (OSError, NotImplementedError):  # Windows without the right to make links, a network drive
            inside_folder(made).write_text(f"{folder.name}\n", encoding="utf-8")
        made.replace(mark)


def named_run(path: Path) -> Path:
    """The folder that 'latest' or 'runs/latest' names; any other path as it is. Raises ConfigError where there is no run."""
    mark = Path(RUNS) / LATEST if path == Path(LATEST) and not path.exists() else path
    if mark.name != LATEST or mark.parent.name != RUNS or mark.is_dir() and not mark.is_symlink():
        return mark
    if mark.is_symlink():
        folder = mark.parent / mark.readlink()
    elif mark.is_file():
        folder = mark.parent / mark.read_text(encoding="utf-8").strip()
    else:
        raise ConfigError(f"{mark} does not exist, there is no run yet; start one, such as mbcacq run plans/quick.yaml --dry-run")
    if not folder.is_dir():
        raise ConfigError(f"{mark} names the run {folder}, which is gone; give the folder of another run")
    return folder


def refuse_plan(path: Path) -> None:
    """Raises ConfigError where a plan is given instead of what was recorded with it."""
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return
    with path.open("rb") as file:
        if b"mbcacq-plan/" not in file.read(10_000):
            return
    raise ConfigError(
        f"{path} is a plan, nothing was measured yet; execute it (without hardware: mbcacq run {path} --dry-run), then give the folder of "
        "the run, or 'latest'"
    )
