"""``mbcacq fleet``: many recordings on a cluster, the arms compared over time."""

from __future__ import annotations

from pathlib import Path

import click

import mbcacq
from mbcacq.cli.declared import FOLDER, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.terminal import console as terminal_console

MOST_NAMED = 10  # broken recordings and outliers that are printed; the page has more


@subcommand("fleet")
def command(
    runs: tuple[Path, ...] = argument(RunPath(checks_too=True), required=True),
    out: Path = option("Folder of the results.", FOLDER, required=True),
    workers: int | None = option("Processes on this computer (default: one for each processor core).", click.IntRange(1)),
    scheduler: str | None = option("Use the dask cluster of this scheduler, e.g. tcp://host:8786.", metavar="ADDRESS"),
    diagnose: bool = option("Also look for effects that the model lacks."),
    verify: Path | None = option("Also try this calibrated arm (a result.json) on every recording.", RunPath(), metavar="RESULT"),
    place: str = option("With --verify known: nothing is fitted.", ["fitted", "known"], default="fitted"),
) -> Answer:
    """Calibrate and verify RUNS: recordings, folders below which recordings lie, or CSV tables with columns recording, arm, time.

    Writes fleet.parquet (a row for each recording), fleet.html (drift of each arm with control limits, arms of one type beside each other,
    outliers) and recordings/ (each result). Recordings that are done there already are not repeated. A broken recording is a row with its
    reason. It needs the extra 'fleet': pip install 'mbcacq[fleet]'.

    \b
    Examples:
      mbcacq fleet runs/ --out fleet
      mbcacq fleet arms.csv --out fleet --diagnose --workers 8
      mbcacq fleet runs/ --out fleet --scheduler tcp://cluster:8786
      mbcacq calibrate next-arm --prior fleet
    """
    task = mbcacq.FleetTask(diagnose=diagnose, verify="" if verify is None else str(verify.absolute()), place=place)
    with FleetProgress() as progress:
        found = mbcacq.evaluate_fleet(runs, out, task=task, workers=workers, scheduler=scheduler, progress=progress)
    outside = sorted({o.recording for o in found.outliers if o.recording})
    unlike = sorted({o.arm for o in found.outliers if o.recording is None})
    broken = [{"recording": row.recording, "status": row.status, "reason": row.reason} for row in found.broken]
    files = {"table": str(found.table), "page": str(found.page)}
    content = {"recordings": len(found.rows), "broken": broken, "outside": outside, "unlike": unlike, "files": files}
    lines = [f"{len(found.rows)} recordings, {len(broken)} without a result, {len(outside)} outside the control limits of their arm"]
    lines += [f"{row.recording}: {row.status}: {row.reason}" for row in found.broken[:MOST_NAMED]]
    for recording in outside[:MOST_NAMED]:
        lines.append(f"{recording}: outside: {', '.join(sorted({o.name for o in found.outliers if o.recording == recording}))}")
    lines += [f"unlike the other arms of the type: {', '.join(unlike)}"] if unlike else []
    lines += [f"{path} was damaged; its recording was evaluated anew" for path in found.damaged]
    lines += [f"{name}: {file}" for name, file in files.items()]
    return Answer({"format": "mbcacq-fleet/1", **content}, lines, ("look at the arms over time", command_line("serve", out)))


class FleetProgress:
    """A bar on a terminal, a line now and then elsewhere; on stderr. A callable that is a context."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._console = terminal_console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=self._console
        )
        self._terminal, self._task = self._console.is_terminal, None

    def __call__(self, done: int, total: int, row: object) -> None:
        if self._terminal:
            if self._task is None:
                self._task = self._bar.add_task("recordings", total=total)
            self._bar.update(self._task, completed=done)
        elif done == total or done % max(total // 10, 1) == 0:
            self._console.print(f"{done} of {total} recordings", soft_wrap=True)

    def __enter__(self) -> FleetProgress:
        if self._terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            self._bar.stop()
