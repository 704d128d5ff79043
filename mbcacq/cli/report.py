"""``mbcacq report``: a run with its calibration, verification and diagnosis, as one HTML page."""

from __future__ import annotations

from pathlib import Path

import mbcacq
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line, put_to_use
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.errors import ConfigError
from mbcacq.recording.run_folder import register
from mbcacq.report.sources import check_result, run_folder
from mbcacq.workflow import load


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
        path = mbcacq.write_report(run, out, diagnose=with_diagnosis, progress=progress)
    document = {"format": "mbcacq-report/1", "report": str(path), "bytes": path.stat().st_size}
    return Answer(document, [str(path)], next_step(run))


def next_step(run: Path) -> tuple[str, str]:
    """What to do after a report, and the command for it."""
    if load.is_run_folder(run) and register.kind_of(run) is register.RunKind.CHECK:
        what, command = check_result.read_check_result(run)["next"]
        return what, command
    if not load.is_run_folder(run) and load.as_observations(run).cell.robot.of_flange_poses:
        return "hold the usual methods for the hand-eye transformation against it", command_line("compare", run)
    kept = run_folder.read_kept_findings(run)
    if "diagnosis" not in kept:
        return "ask which effects the model lacks", command_line("diagnose", run)
    if "with_effects" not in kept and kept["diagnosis"].get("model"):
        return "calibrate with what was found", command_line("diagnose", run, "--calibrate")
    return put_to_use(run / run_folder.WITH_EFFECTS if "with_effects" in kept else run)
