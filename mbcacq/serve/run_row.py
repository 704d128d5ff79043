"""What the list of runs and the page of a run show of one run."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.serve.live import LiveProgress
from mbcacq.serve.overview import Overview
from mbcacq.serve.run_list import ListedFolder


@dataclass(frozen=True)
class RunRow:
    """files: names of those that its page links to."""

    found: ListedFolder
    overview: Overview
    progress: LiveProgress
    files: tuple[str, ...] = ()
