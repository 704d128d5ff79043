"""Which of many runs one page shows: a search, a kind, a cell, and then a page of them, the newest first."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from mbcacq.recording.run_folder.lock import OWNER_FILE, lock_owner
from mbcacq.recording.run_folder.register import RunKind, kind_of
from mbcacq.serve.run_list import MOST, ListedFolder

ON_A_PAGE = 50
NAMED = re.compile(r"(\d{4}-\d\d-\d\d)T(\d\d)-(\d\d)-(\d\d)_(check-)?(.+)")  # as commands name the folder of a recording


def cell_of(run: ListedFolder) -> str:
    """What the name of a folder says was measured: plan or cell, without time and kind."""
    named = NAMED.fullmatch(run.folder.name)
    return named[6] if named else run.folder.name


def time_of(run: ListedFolder) -> str:
    """Local date and time, by the name of the folder; of another name, its last change."""
    if named := NAMED.fullmatch(run.folder.name):
        return f"{named[1]} {named[2]}:{named[3]}:{named[4]}"
    try:
        return f"{datetime.fromtimestamp(run.folder.stat().st_mtime):%Y-%m-%d %H:%M:%S}"
    except (OSError, OverflowError, ValueError):
        return ""


@lru_cache(maxsize=MOST)
def _kind_since(folder: Path, changed_ns: int) -> RunKind:
    """The kind of a recording; read again once a file of it was written."""
    return kind_of(folder)


@dataclass(frozen=True)
class RunChoice:
    """What is asked for: words that names or dates have, a kind, a cell, and the number of the page, from 1."""

    words: str = ""
    kind: str = ""
    cell: str = ""
    page: int = 1

    @classmethod
    def asked(cls, given: Callable[[str], str | None]) -> RunChoice:
        """From the fields of an address; what makes no sense counts as not given."""
        words, kind, cell, page = ((given(name) or "")[:200] for name in ("q", "kind", "cell", "page"))
        number = int(page) if page.isascii() and page.isdigit() and len(page) < 7 else 1
        return cls(words.strip(), kind if kind in set(RunKind) else "", cell, max(number, 1))

    def fits(self, run: ListedFolder, when: str) -> bool:
        said = f"{run.name} {when}".lower()
        return (
            all(word in said for word in self.words.lower().split())
            and self.cell in ("", cell_of(run))
            and (not self.kind or _kind_since(run.folder, run.changed_ns) == self.kind)
        )

    def at(self, page: int) -> RunChoice:
        return replace(self, page=page)

    @property
    def fields(self) -> dict[str, str | int]:
        """Those of the address, without what is not asked for."""
        given = {"q": self.words, "kind": self.kind, "cell": self.cell, "page": self.page if self.page > 1 else ""}
        return {name: value for name, value in given.items() if value}


@dataclass(frozen=True)
class ChosenRuns:
    """shown: of one page. locked: that a process holds, or has left its name in. cells: names and numbers of recordings, of all runs."""

    shown: list[ListedFolder]
    locked: list[ListedFolder]
    cells: dict[str, int]
    number: int
    pages: int


def chosen(runs: list[ListedFolder], choice: RunChoice) -> ChosenRuns:
    """Without reading more of a run than its name, its lock, and its kind where one is asked for."""
    times = {run.key: time_of(run) for run in runs}
    fitting = sorted((r for r in runs if choice.fits(r, times[r.key])), key=lambda r: (times[r.key], r.name), reverse=True)
    pages = max(-(-len(fitting) // ON_A_PAGE), 1)
    first = ON_A_PAGE * (min(choice.page, pages) - 1)
    several = {name: count for name, count in Counter(map(cell_of, runs)).most_common() if count > 1}
    locked = [run for run in runs if OWNER_FILE in run.files and lock_owner(run.folder) is not None]
    return ChosenRuns(fitting[first : first + ON_A_PAGE], locked, several, len(fitting), pages)
