"""``mbcacq compare``: calibration methods side by side on the same data, or two recordings of one arm."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

import mbcacq
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import titled_table
from mbcacq.errors import ConfigError
from mbcacq.workflow import changes_page, compare_runs


@subcommand("compare")
def command(
    data: Path = argument(RunPath()),
    other: Path | None = argument(RunPath(), required=False),
    report: Path | None = option("With OTHER: also a page with charts (HTML).", FILE),
    no_held_out: bool = option("Leave out the refits without some stations."),
    seed: int = option("Seed of the split.", default=0),
) -> Answer:
    """Calibrate the recording DATA in every way and compare. The ways are nominal, AX=XB and AX=ZB (Tsai-Lenz, Park-Martin,
    Horaud-Dornaika, Andreff, Daniilidis; Shah, Li), hand-eye only, the paper's method (as printed, and with more pairs of balls), distance
    constraint only, and maximum likelihood. A method that DATA does not determine is listed with the reason.

    With OTHER, a second recording of the same arm: what changed from DATA to OTHER, parameter by parameter and effect by effect. Both are
    run folders with a result, or a result.json. The estimates of each recording alone are compared, without the prior that a calibration
    has of the arm's links.

    \b
    Examples:
      mbcacq compare runs/today
      mbcacq compare runs/monday runs/friday --report changes.html
    """
    if other is not None:
        return _changes(data, other, report)
    if report is not None:
        raise ConfigError("--report is of two recordings; give the second one, or take mbcacq report")

    with StepProgress() as progress:
        progress("reading the recording")
        rows = mbcacq.compare(data, held_out=not no_held_out, seed=seed, progress=progress)
    # A long name of a method takes two lines, so that all fits 80 columns.
    headings = ("method", "fit rms", "bar mean", "bar max", "held-out", "time s")
    table = titled_table(f"{data} (mm)", *headings, left=["method"], no_wrap=True)
    for row in rows:
        values = (row.fit_mm, row.bar_mean_mm, row.bar_max_mm, row.held_out_mm)
        shown = [f"{v:.4f}" if v is not None else "-" for v in values]
        table.add_row(row.method, *shown, f"{row.time_s:.2f}" if row.time_s is not None else "-")
    lines: list[str | Table] = [table]
    for why in dict.fromkeys(row.why for row in rows if row.why):
        names = ", ".join(row.method for row in rows if row.why == why)
        lines.append(f"Undetermined: {names}: {why}")
    for why in dict.fromkeys(row.why_not_held_out for row in rows if row.why_not_held_out):
        names = ", ".join(row.method for row in rows if row.why_not_held_out == why)
        lines.append(f"Nothing held out: {names}: without some poses, {why}")
    alone = () if any(row.method == "maximum likelihood" and row.fit_mm is not None for row in rows) else ("--hand-eye-only",)
    document = {"format": "mbcacq-comparison/1", "data": str(data), "rows": rows.to_dict()["rows"]}
    then = ("calibrate by maximum likelihood", command_line("calibrate", data, *alone, "--out", "result.json"))
    if (data / "result.json").exists():
        then = ("see what its calibration by maximum likelihood says", command_line("report", data))
    return Answer(document, lines, then)


def _changes(first: Path, second: Path, report: Path | None) -> Answer:
    """The comparison of two recordings."""
    with StepProgress() as progress:
        progress("comparing")
        found = compare_runs.compare_runs(first, second)
        if report is not None:
            progress("drawing the page")
            changes_page.write_page(found, report)
    table = titled_table("± U, k = 2; ! is beyond chance", "", "before", "after", "change", "unit", left=["", "unit"])
    for marked, name, *shown in found.table:
        table.add_row(f"{'! ' * marked}{name}", *(text.replace(" ± ", "\n± ") for text in shown))
    lines = [f"{found.robot}: {first} (before), {second} (after)", table, *found.sentences, found.how]
    if report is not None:
        return Answer(found.to_dict(), [*lines, f"page: {report}"], found.next_step)
    then = "see it with its charts", command_line("compare", first, second, "--report", "changes.html")
    return Answer(found.to_dict(), lines, then)
