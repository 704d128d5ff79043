"""``mbcacq diagnose``: where simulation and recording differ, and which effects the model lacks."""

from __future__ import annotations

from pathlib import Path

import click

from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo


@click.command(name="diagnose")
@click.argument("data", nargs=-1, required=True, type=RunPath())
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the diagnosis to this JSON file.")
@click.option("--json", "as_json", is_flag=True, help="Print the diagnosis as one JSON object on stdout.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), help="Write an HTML report with pictures.")
@click.option("--rrd", type=click.Path(path_type=Path, dir_okay=False), help="Write error arrows before and after as a rerun recording.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the cross-validation (default: one for each processor core).")
@click.option("--phase", "phases", multiple=True, help="Use poses of this phase only (repeatable) [default: all but verification].")
@click.option("--hold", multiple=True, metavar="NAME", help="Keep this parameter at its nominal value, e.g. d_2 (repeatable).")
@click.option("--free", multiple=True, metavar="NAME", help="Free a parameter that would be held as redundant (repeatable).")
@click.option(
    "--check",
    multiple=True,
    type=RunPath(),
    metavar="OTHER",
    help="Try what was learnt on this recording of the same arm (repeatable): its base, tool and stations are fitted, nothing else.",
)
@click.option("--place", type=click.Choice(["fitted", "known"]), default="fitted", help="With --check known: nothing is fitted.")
def command(
    data: tuple[Path, ...],
    out: Path | None,
    as_json: bool,
    report: Path | None,
    rrd: Path | None,
    workers: int | None,
    phases: tuple[str, ...],
    hold: tuple[str, ...],
    free: tuple[str, ...],
    check: tuple[Path, ...],
    place: str,
) -> None:
    """Diagnose DATA: a run folder ('latest': the newest in runs), an .rrd, an observation set; or trajectory sets of one robot, together.

    In the folder of a run the diagnosis is kept (diagnosis.json, diagnosis.rrd): mbcacq report and mbcacq view show it from then on.

    \b
    Examples:
      mbcacq diagnose latest
      mbcacq diagnose ur5-tracker --report diagnosis.html --rrd diagnosis.rrd
      mbcacq diagnose ur10-tracker-a --check ur10-tracker-c --out diagnosis.json
    """
    import mbcacq
    from mbcacq.errors import ConfigError
    from mbcacq.workflow.load import is_run_folder

    options = mbcacq.CalibrationOptions(phases=phases or None, hold=hold, release=free)
    with StepProgress() as progress:
        progress("reading the recording")
        found = mbcacq.diagnose(data, progress=progress, workers=workers, options=options, check=check, place=place)
        if found.poses is not None:
            progress("writing the pictures")
            if report is not None:
                found.write_html(report)
            if rrd is not None:
                found.write_rrd(rrd)
            if is_run_folder(data[0]):
                found.keep(data[0])
    if out is not None:
        try:
            out.write_text(found.to_json() + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"cannot write {out}: {error.strerror}; give another --out") from error
    echo(found.to_json() if as_json else found.text)
