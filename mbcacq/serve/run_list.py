"""The runs and fleets below a folder. A page names one by its key, never by a path: what was not found here cannot be asked for."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
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
    """key: stands for the folder in addresses; name: of the folder, below the one that is served, as text that can be shown; files: names
    of those in it; changed_ns: when one of them came, went or was replaced."""

    key: str
    name: str
    folder: Path
    files: frozenset[str]
    changed_ns: int


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
    runs, fleets = [], []
    folders = list(islice(_folders(root, "", DEPTH), MOST + 1))
    for found in folders[:MOST]:
        if FLEET_PAGE in found.files or FLEET_TABLE in found.files:
            fleets.append(found)
        elif not found.files.isdisjoint(RUN_FILES) or any(name.startswith("run") and name.endswith(".rrd") for name in found.files):
            runs.append(found)
    ordered = [sorted(found, key=lambda f: f.name, reverse=True) for found in (runs, fleets)]
    return RunList(*({f.key: f for f in found} for found in ordered), left_out=len(folders) > MOST)


def _folders(folder: Path | str, below: str, depth: int) -> Iterator[ListedFolder]:
    """A folder and those below, not what is inside of a run or a fleet. below: its path below the first one."""
    try:
        with os.scandir(folder) as entries:
            listed = list(entries)
        files = frozenset(e.name for e in listed if e.is_file(follow_symlinks=False))
        folders = [e for e in listed if e.is_dir(follow_symlinks=False) and not e.name.startswith(".")]
        changed_ns = os.stat(folder).st_mtime_ns
    except OSError:
        return
    name = os.fsencode(below or Path(folder).absolute().name)
    yield ListedFolder(hashlib.sha256(name).hexdigest()[:16], name.decode("utf-8", "replace"), Path(folder), files, changed_ns)
    if depth and files.isdisjoint((*RUN_FILES, FLEET_PAGE, FLEET_TABLE)):
        for entry in sorted(folders, key=lambda e: e.name, reverse=True):
            yield from _folders(entry.path, os.path.join(below, entry.name), depth - 1)
