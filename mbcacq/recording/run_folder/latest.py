"""Which run is meant: ``latest`` beside the folders of the runs is a link to the newest one, or a file with its name where links are not
possible; a plan is none, and a check is none either."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import inside_folder
from mbcacq.recording.rrd.run_header import read_run_header
from mbcacq.recording.run_folder.register import CALIBRATED_FROM, RunKind, kind_of, newest

RUNS, LATEST = "runs", "latest"


def mark_latest(folder: Path, kind: RunKind = RunKind.RUN) -> None:
    """Let ``latest`` name this folder of a run, if it stands in a folder 'runs' and is no check. Anything else of that name stays; so does
    a run whose mark cannot be written."""
    folder = folder.absolute()
    mark = folder.parent / LATEST
    if kind not in CALIBRATED_FROM or folder.parent.name != RUNS or folder == mark or mark.is_dir() and not mark.is_symlink():
        return
    made = mark.with_name(f".{LATEST}-{os.getpid()}")  # replaced in one step: two runs may start at once
    with suppress(OSError):
        try:
            made.symlink_to(folder.name, target_is_directory=True)
        except (OSError, NotImplementedError):  # Windows without the right to make links, a network drive
            inside_folder(made).write_text(f"{folder.name}\n", encoding="utf-8")
        made.replace(mark)


def named_run(path: Path, kinds: frozenset[RunKind] = CALIBRATED_FROM) -> Path:
    """The folder that 'latest' or 'runs/latest' names, which is the newest of these kinds; any other path as it is. Raises ConfigError
    where there is none."""
    mark = Path(RUNS) / LATEST if path == Path(LATEST) and not path.exists() else path
    if mark.name != LATEST or mark.parent.name != RUNS or mark.is_dir() and not mark.is_symlink() and not _is_copy(mark):
        return mark
    marked = _marked(mark)
    if kinds == CALIBRATED_FROM and marked is not None and marked.is_dir() and kind_of(marked) in kinds:
        return marked
    if (found := newest(mark.parent, kinds)) is not None:
        return found
    if marked is None or marked.is_dir():
        what = "run" if RunKind.RUN in kinds else "check"
        advice = "give the folder of one, or start one: mbcacq run kuka --dry-run"
        raise ConfigError(f"{mark} does not exist, {mark.parent} holds no {what} yet; {advice}")
    raise ConfigError(f"{mark} names the run {marked}, which is gone; give the folder of another run")


def _is_copy(folder: Path) -> bool:
    """Whether a folder holds the recording of one beside it: a program that copied the folder of the runs followed the link."""
    header = read_run_header(folder)
    return header is not None and any(read_run_header(other) == header for other in folder.parent.iterdir() if other != folder)


def _marked(mark: Path) -> Path | None:
    """The folder beside it that a mark names, there or not; None if there is no mark, or one of somebody else that leads elsewhere."""
    name = str(mark.readlink()) if mark.is_symlink() else mark.read_text(encoding="utf-8").strip() if mark.is_file() else ""
    return mark.parent / name if name and Path(name).name == name != ".." else None


def refuse_plan(path: Path) -> None:
    """Raises ConfigError if a plan is given instead of what was recorded with it."""
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return
    with path.open("rb") as file:
        if b"mbcacq-plan/" not in file.read(10_000):
            return
    raise ConfigError(
        f"{path} is a plan, nothing was measured yet; execute it (without hardware: mbcacq run {path} --dry-run), then give the folder of "
        "the run, or 'latest'"
    )
