"""``mbcacq fleet``: many recordings on a cluster, the arms compared over time."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo

MOST_NAMED = 10  # broken recordings and outliers that are printed; the page has more


@click.command("fleet")
@click.argument("runs", nargs=-1, required=True, type=RunPath(checks_too=True))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of the results.")
@click.option("--workers", type=click.IntRange(1), help="Processes on this computer (default: one for each processor core).")
@click.option("--scheduler", metavar="ADDRESS", help="Use the dask cluster of this scheduler, e.g. tcp://host:8786.")
@click.option("--diagnose", is_flag=True, help="Also look for effects that the model lacks.")
@click.option("--verify", type=RunPath(), metavar="RESULT", help="Also try this calibrated arm (a result.json) on every recording.")
@click.option(
    "--place", type=click.Choice(["fitted", "known"]), default="fitted", show_default=True, help="With --verify known: nothing is fitted."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(
    runs: tuple[Path, ...],
    out: Path,
    workers: int | None,
    scheduler: str | None,
    diagnose: bool,
    verify: Path | None,
    place: str,
    as_json: bool,
) -> None:
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
    import mbcacq

    task = mbcacq.FleetTask(diagnose=diagnose, verify="" if verify is None else str(verify.absolute()), place=place)
    with FleetProgress() as progress:
        found = mbcacq.evaluate_fleet(runs, out, task=task, workers=workers, scheduler=scheduler, progress=progress)
    outside = sorted({o.recording for o in found.outliers if o.recording})
    unlike = sorted({o.arm for o in found.outliers if o.recording is None})
    if as_json:
        broken = [{"recording": row.recording, "status": row.status, "reason": row.reason} for row in found.broken]
        files = {"table": str(found.table), "page": str(found.page)}
        content = {"recordings": len(found.rows), "broken": broken, "outside": outside, "unlike": unlike, "files": files}
        echo(json.dumps({"format": "mbcacq-fleet/1", **content}))
        return
    echo(f"{len(found.rows)} recordings, {len(found.broken)} without a result, {len(outside)} outside the control limits of their arm")
    for row in found.broken[:MOST_NAMED]:
        echo(f"{row.recording}: {row.status}: {row.reason}")
    for recording in outside[:MOST_NAMED]:
        names = sorted({o.name for o in found.outliers if o.recording == recording})
        echo(f"{recording}: outside: {', '.join(names)}")
    if unlike:
        echo(f"unlike the other arms of the type: {', '.join(unlike)}")
    for path in found.damaged:
        echo(f"{path} was damaged; its recording was evaluated anew")
    echo(f"table: {found.table}")
    echo(f"page: {found.page}")
    say_next("look at the arms over time", command_line("serve", out))


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
