"""The runs and fleets below a folder. A page names one by its key, never by a path: what was not found here cannot be asked for."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.recording.rrd import layout
from mbcacq.recording.run_folder.run_plan import PLAN

DEPTH = 3  # folders below the one that is served
MOST = 5000  # folders that are looked into
FLEET_PAGE, FLEET_TABLE = "fleet.html", "fleet.parquet"
RUN_FILES = (layout.JOURNAL_FILE, "result.json", "diagnosis.json", PLAN)


@dataclass(frozen=True)
class ListedFolder:
    """key: stands for the folder in addresses; name: of the folder, below the one that is served, as text that can be shown."""

    key: str
    name: str
    folder: Path


@dataclass(frozen=True)
class RunList:
    """runs, fleets: by key, in the order of their names, the last first. left_out: there are more folders than were looked into."""

    runs: dict[str, ListedFolder] = field(default_factory=dict)
    fleets: dict[str, ListedFolder] = field(default_factory=dict)
    left_out: bool = False


def find_runs(root: Path) -> RunList:
    """The folders of runs and fleets below a folder, or the folder itself. Links are not followed.

    Raises ConfigError if it is no folder that can be read.
    """
    try:
        os.scandir(root).close()
    except OSError as error:
        raise ConfigError(f"{root} cannot be read as a folder of runs: {error.strerror}; give the folder that holds them") from None
    runs, fleets, count = [], [], 0
    for folder, names in _folders(root, DEPTH):
        count += 1
        if count > MOST:
            break
        if FLEET_PAGE in names or FLEET_TABLE in names:
            fleets.append(_found(root, folder))
        elif names & set(RUN_FILES) or any(name.startswith("run") and name.endswith(".rrd") for name in names):
            runs.append(_found(root, folder))
    ordered = [sorted(found, key=lambda f: f.name, reverse=True) for found in (runs, fleets)]
    return RunList(*({f.key: f for f in found} for found in ordered), left_out=count > MOST)


def _folders(folder: Path, depth: int) -> Iterator[tuple[Path, set[str]]]:
    """A folder and those below, each with the names of its files; not what is inside of a run or a fleet."""
    try:
        with os.scandir(folder) as entries:
            listed = list(entries)
        names = {e.name for e in listed if e.is_file(follow_symlinks=False)}
        below = [e.path for e in listed if e.is_dir(follow_symlinks=False) and not e.name.startswith(".")]
    except OSError:
        return
    yield folder, names
    if depth and not names & {*RUN_FILES, FLEET_PAGE, FLEET_TABLE}:
        for path in sorted(below, reverse=True):
            yield from _folders(Path(path), depth - 1)


def _found(root: Path, folder: Path) -> ListedFolder:
    below = os.path.relpath(folder, root)
    name = folder.absolute().name if below == os.curdir else below
    raw = os.fsencode(name)
    return ListedFolder(hashlib.sha256(raw).hexdigest()[:16], raw.decode("utf-8", "replace"), folder)
