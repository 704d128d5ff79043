"""``mbcacq report``: a run with its calibration, verification and diagnosis, as one HTML page."""

from __future__ import annotations

from pathlib import Path

from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.workflow.report import report_and_next


@subcommand("report")
def command(
    run: Path = argument(RunPath(checks_too=True)),
    out: Path | None = option("The page [default: report.html in the folder of the run].", FILE),
    pdf: bool = option("A PDF on A4 instead of the page [default: report.pdf in the folder of the run]."),
    with_diagnosis: bool = option("Make a diagnosis first, if there is none yet.", None, "--diagnose"),
) -> Answer:
    """Write the report of RUN: one HTML page that opens offline and prints well, or a PDF.

    RUN is a run folder ('latest': the newest in runs), a recording (.rrd) or an observation set. A result that is there is used,
    otherwise the cell is calibrated; so is a diagnosis that 'mbcacq diagnose' kept in the folder of a run.
    The page of a check says what it found.

    \b
    Examples:
      mbcacq report latest
      mbcacq report latest --pdf
      mbcacq report ur5-tracker --diagnose --out ur5.html
    """
    if pdf and out is None and run.is_dir():
        out = run / "report.pdf"
    if pdf and out is not None and out.suffix.lower() != ".pdf":
        raise ConfigError(f"{out} does not end in .pdf, as --pdf asks for; give another --out")
    with StepProgress() as progress:
        path, then = report_and_next(run, out, with_diagnosis, progress)
    document = {"format": "mbcacq-report/1", "report": str(path), "bytes": path.stat().st_size}
    return Answer(document, [str(path)], then)
