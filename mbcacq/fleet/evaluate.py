"""Evaluate a fleet: every recording on the cluster, then the table, the outliers and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.fleet.cluster import evaluated
from mbcacq.fleet.control_chart import Outlier, arm_types, outliers
from mbcacq.fleet.evaluation import FleetTask
from mbcacq.fleet.page import fleet_content
from mbcacq.fleet.recordings import FleetRecording, find_recordings
from mbcacq.fleet.row import EVALUATED, FleetRow
from mbcacq.fleet.store import FleetStore

Progress = Callable[[int, int, FleetRow], None]


@dataclass(frozen=True)
class Fleet:
    """What became of a fleet. rows: one a recording, as in the table; outliers: what is outside the control limits; table, page: files;
    damaged: results kept before that were damaged and were computed anew."""

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

    recordings: as ``mbcacq.fleet.recordings.find_recordings`` takes them. out: folder of the results; what is done there already is
    not repeated. workers: processes on this computer (default: one a core); scheduler: address of a running dask cluster instead.
    progress: gets how many are done, how many there are, and the row. A script that calls this needs ``if __name__ == "__main__":``.

    Raises ConfigError for recordings that cannot be found, ConnectError where the scheduler does not answer; never for a broken recording.
    """
    from mbcacq.diagnosis.workers import cores
    from mbcacq.report import fleet_page

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
    table, page = store.write(rows, fleet_page(fleet_content(rows, kinds, outside)))
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
