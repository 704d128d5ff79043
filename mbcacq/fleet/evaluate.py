"""Evaluate a fleet: every recording on the cluster, then the table, the outliers and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mbcacq.diagnosis.executor import cores
from mbcacq.errors import ConfigError
from mbcacq.fleet.cluster import evaluated
from mbcacq.fleet.control_chart import Outlier, arm_types, outliers
from mbcacq.fleet.evaluation import FleetTask
from mbcacq.fleet.page import fleet_content
from mbcacq.fleet.recordings import FleetRecording, find_recordings
from mbcacq.fleet.row import EVALUATED, FleetRow
from mbcacq.fleet.store import FleetStore
from mbcacq.report.page import render_fleet

Progress = Callable[[int, int, FleetRow], None]


@dataclass(frozen=True)
class Fleet:
    """The results of many recordings.

    Attributes
    ----------
    rows
        One row for each recording, as in the table.
    outliers
        Figures outside the control limits.
    table, page
        Files.
    damaged
        Results kept before that were damaged and were computed anew.
    """

    rows: tuple[FleetRow, ...]
    outliers: tuple[Outlier, ...]
    table: Path
    page: Path
    damaged: tuple[Path, ...] = ()

    @property
    def broken(self) -> tuple[FleetRow, ...]:
        """The rows without figures, with their reason."""
        return tuple(row for row in self.rows if row.status != EVALUATED)


def evaluate_fleet(
    recordings: Sequence[Path | str],
    out: Path | str,
    *,
    task: FleetTask | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = lambda done, total, row: None,
) -> Fleet:
    """Calibrate (diagnose, verify) many recordings on a cluster and compare them.

    A script that calls this function needs ``if __name__ == "__main__":``.

    Parameters
    ----------
    recordings
        As ``mbcacq.fleet.recordings.find_recordings`` takes them.
    out
        Folder of the results. Recordings that were evaluated there already are not evaluated again.
    task
        What is done with each recording.
    workers
        Processes on this computer (default: one for each core).
    scheduler
        Address of a running dask cluster, which is used instead.
    progress
        Called with the number of recordings that are done, the number of all, and the row.

    Returns
    -------
    Fleet
        Rows, outliers and files. A broken recording is a row with its reason.

    Raises
    ------
    ConfigError
        Recordings cannot be found.
    ConnectError
        The scheduler does not answer.
    """
    task = task or FleetTask()
    if not recordings:
        raise ConfigError("there are no recordings to evaluate; give some, or a folder of them")
    if task.verify and not Path(task.verify).exists():
        raise ConfigError(f"{task.verify} does not exist; give the result.json of a calibration to --verify")
    found = find_recordings(recordings)
    store = FleetStore(Path(out), task)
    rows = rows_of(store, found, task, workers or cores(), scheduler, progress)
    kinds = arm_types(rows)
    outside = outliers(kinds)
    for row in rows:
        row.out_of_control = tuple(sorted({o.name for o in outside if o.recording == row.recording}))
    table, page = store.write(rows, render_fleet(fleet_content(rows, kinds, outside)))
    return Fleet(tuple(rows), tuple(outside), table, page, tuple(store.damaged))


def rows_of(
    store: FleetStore, found: Sequence[FleetRecording], task: FleetTask, workers: int, scheduler: str | None, progress: Progress
) -> list[FleetRow]:
    """The rows of all recordings in their order; each result is kept as soon as it is there."""
    known = {one.path: row for one in found if (row := store.row(one)) is not None}
    left = [one for one in found if one.path not in known]
    done = len(known)
    if left:
        for one, row in evaluated(left, store, task, min(workers, len(left)), scheduler):
            known[one.path] = row
            done += 1
            progress(done, len(found), row)
    return [known[one.path] for one in found]
