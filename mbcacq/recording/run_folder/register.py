"""Which kinds of recordings a folder of runs holds, and which is the newest of a kind: every command that is given 'latest' asks here."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from mbcacq.errors import ConfigError, command_line
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.run_header import read_run_header
from mbcacq.recording.run_folder.run_plan import FILES

CHECK_RESULT = "check-result.json"  # what a check of a calibrated cell said
OLDER_CHECK = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d_check-.+")  # the folder of a check whose files do not state a kind
MOST_BYTES = 16 << 20  # of the file that states a kind


class RunKind(StrEnum):
    """What a recording was made for. A run executes a plan; an extension added the poses of another plan to a run; an investigation chose
    its poses itself; a collected run is made of clouds from a folder; a check repeats few poses; simulated data have no devices behind
    them."""

    RUN = "run"
    CHECK = "check"
    EXTENSION = "extension"
    INVESTIGATION = "investigation"
    COLLECTED = "collected"
    SIMULATED = "simulated"


ANY_KIND = frozenset(RunKind)
CALIBRATED_FROM = ANY_KIND - {RunKind.CHECK}  # a recording that can be calibrated by itself


@dataclass(frozen=True)
class RegisteredRun:
    """One recording of a folder of runs. started: ISO 8601, '' if nothing says it."""

    folder: Path
    kind: RunKind
    started: str


def kind_of(folder: Path) -> RunKind:
    """The kind of a recording, as its own files state it; of one that states nothing, as its other files and its name say."""
    try:
        with (folder / FILES).open("rb") as file:
            return RunKind(json.loads(file.read(MOST_BYTES))["kind"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        pass
    if (folder / CHECK_RESULT).exists() or OLDER_CHECK.fullmatch(folder.name):
        return RunKind.CHECK
    if (folder / layout.INVESTIGATION_FILE).exists():
        return RunKind.INVESTIGATION
    return RunKind.SIMULATED if (folder / "cell.yaml").exists() and not layout.parts(folder) else RunKind.RUN


def registered(runs: Path) -> Iterator[RegisteredRun]:
    """The recordings that lie in a folder of runs; links are not followed."""
    try:
        with os.scandir(runs) as entries:
            folders = [Path(e.path) for e in entries if e.is_dir(follow_symlinks=False) and not e.name.startswith(".")]
    except OSError:
        return
    for folder in folders:
        if layout.parts(folder) or (folder / layout.JOURNAL_FILE).exists() or (folder / "cell.yaml").exists():
            header = read_run_header(folder)
            yield RegisteredRun(folder, kind_of(folder), "" if header is None else header.started)


def newest(runs: Path, kinds: frozenset[RunKind]) -> Path | None:
    """The folder of the newest recording of these kinds; None if there is none."""
    found = [one for one in registered(runs) if one.kind in kinds]
    return max(found, key=lambda one: (one.started, one.folder.name)).folder if found else None


def refuse_other_kind(folder: Path, kinds: frozenset[RunKind]) -> None:
    """Raises ConfigError if a check is given to what needs a recording that determines a cell."""
    if RunKind.CHECK not in kinds and folder.is_dir() and kind_of(folder) is RunKind.CHECK and not (folder / "result.json").exists():
        raise ConfigError(
            f"{folder} is a check: its few poses are compared with a calibrated cell and determine none; give the run that it checked, or "
            f"read what it said: {command_line('report', folder)}"
        )
