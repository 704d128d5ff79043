"""``mbcacq check``: a few poses repeated, and whether anything changed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.cli.next_step import command_line, forget_failure, on_failure, say_next
from mbcacq.cli.operator import MotionOptions, moves_an_arm
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.terminal import echo
from mbcacq.quantities import capitalised

if TYPE_CHECKING:
    from mbcacq.interim_check.check import InterimCheck


@click.command("check")
@click.argument("result", type=RunPath())
@click.argument("plan", type=PlanPath())
@click.option("--history", type=click.Path(path_type=Path, dir_okay=False), help="File of all checks [default: check.json beside RESULT].")
@click.option("--from", "measured", type=RunPath("check"), metavar="RUN", help="Judge a check that was measured already; nothing moves.")
@click.option("--poses", default=12, show_default=True, help="Number of poses, chosen at the first check.")
@click.option("--placed-anew", is_flag=True, help="The artefact is placed anew for each check, so its place is not judged.")
@click.option("--part", is_flag=True, help="Judge by the scans of PLAN's part instead of balls [always without balls].")
@click.option("--fleet", type=click.Path(path_type=Path, exists=True), help="Table of mbcacq fleet: how arms change from day to day.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the recording [default: runs/TIME_check-NAME].")
@moves_an_arm()
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as one JSON object on stdout.")
def command(
    result: Path,
    plan: Path,
    history: Path | None,
    measured: Path | None,
    poses: int,
    placed_anew: bool,
    part: bool,
    fleet: Path | None,
    out: Path | None,
    motion: MotionOptions,
    as_json: bool,
) -> None:
    """Repeat the few poses of PLAN that show most of what may have changed since RESULT: mastering, tool, mount, links, gears.

    The poses are chosen at the first check. Each later check repeats them, and all are judged together: what changed, where, since when.
    However many checks are made, there are false alarms in fewer than one of a hundred arms. The exit code is 0 if the cell is as before,
    and 11 if it changed.

    \b
    Examples:
      mbcacq check runs/latest kuka --dry-run
      mbcacq check calibrated/result.json my-cell.yaml --arm
    """
    import mbcacq
    from mbcacq.cli.signals import end_in_order_on_signals
    from mbcacq.cli.step_progress import StepProgress
    from mbcacq.interim_check.check import CheckSettings
    from mbcacq.interim_check.day_to_day import read_day_to_day
    from mbcacq.interim_check.options import UsualChanges

    end_in_order_on_signals()
    steps = StepProgress()
    operator = motion.operator(
        steps,
        began=lambda folder: on_failure(
            "where all poses were measured, judge them", command_line("check", result, plan, "--from", folder), folder / "run.rrd"
        ),
    )
    loaded = mbcacq.load_plan(plan)
    days = UsualChanges() if fleet is None else read_day_to_day(fleet, loaded.cell.robot.name)
    settings = CheckSettings(poses, not placed_anew, days, out, part)
    with steps:
        done = mbcacq.check(
            result,
            loaded,
            history=history,
            measured=measured,
            dry_run=motion.dry_run,
            seed=motion.seed,
            operator=operator,
            settings=settings,
        )
    forget_failure()
    if as_json:
        echo(json.dumps(done.to_dict()))
    else:
        for line in lines_of(done):
            echo(line)
        say_next(*done.next_step(result, plan, motion.dry_run))
    done.refuse_changed()


def lines_of(done: InterimCheck) -> list[str]:
    """What a person reads: the verdict, the evidence, the suspects, and what would have been noticed."""
    from mbcacq.interim_check.words import odds, size_in_words, size_of

    v, days = done.verdict, len(done.history.days)
    sentence = done.sentence
    out = [f"{capitalised(sentence)}."]
    since, before, alarm = (odds(value) for value in (v.log_e, v.log_e_calibration, v.log_threshold))
    out.append(f"evidence for a change since the first check {since}, since the calibration {before}; alarm at {alarm}")
    levels = f"noise {v.noise:g} times the calibration's, changes from day to day {v.day:g} times the usual"
    out.append(f"checks: {days}, of {len(done.history.poses)} poses; {levels}")
    for s in v.suspects:
        out.append(f"  {s.label}: probability {s.probability:.2f}" + (f"; {size}" if (size := size_of(s)) else ""))
    if not done.changed and days > 1:
        out.append("noticed within a week, nine times of ten:")
        out += [f"  {name} ({where}): {size_in_words(size, 0.0, unit)}" for name, where, size, unit in v.noticed]
    page = [f"page: {done.run / 'report.html'}"] if done.run.is_dir() else []
    return [*out, f"recording: {done.run}", f"history: {done.file}", *page]
