"""``mbcacq run``: the whole job, from the plan to the before/after table."""

from __future__ import annotations

import sys
from pathlib import Path

import click

import mbcacq
from mbcacq.cli.calibrate import answer_of_run
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import forget_failure
from mbcacq.cli.operator import MotionOptions
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import printable
from mbcacq.recording.run_folder import run_plan
from mbcacq.workflow import next_plan


@subcommand("run")
def command(
    plan: Path | None = argument(PlanPath(), required=False),
    out: Path | None = option("Run folder [default: runs/TIME_NAME]."),
    resume: Path | None = option("Go on with this run folder: poses already measured are skipped.", RunPath(), metavar="RUN"),
    extend: Path | None = option("Add the poses of PLAN to this finished run, at its own stations.", RunPath(), metavar="RUN"),
    live: bool = option("Serve the recording to a rerun viewer on 127.0.0.1 while it grows."),
    again: bool = option("With --resume: measure stations anew that were measured in part (the artefact was touched)."),
    corrected: Path | None = option("Steer by this calibrated arm: result.json, or folder of a run.", RunPath(), metavar="RESULT"),
    motion: MotionOptions = MotionOptions,  # type: ignore[assignment]
) -> Answer:
    """Execute PLAN, record it, calibrate the cell and show how good it became.

    PLAN is a file, or the name of one that came with mbcacq; with --resume the plan of the run folder, if none is given.
    With --corrected the joint angles of every pose bring the calibrated arm, with its effects, to where the plan means it to be. The
    report then says how far the arm misses its places, before and after. A resumed run keeps its targets.

    \b
    Examples:
      mbcacq run plans/kuka.yaml --dry-run
      mbcacq run my-cell.yaml --arm --step
      mbcacq run other-places.yaml --arm --corrected runs/latest/with-effects
      mbcacq run --arm --resume runs/2026-11-21T10-00-00_my-cell
      mbcacq run next.yaml --arm --extend runs/2026-11-21T10-00-00_my-cell
    """
    end_in_order_on_signals()
    if extend is not None and (resume is not None or out is not None or again):
        raise click.UsageError("--extend goes on in the folder of a finished run; leave --resume, --out and --again out")
    to_run = plan_of(resume) if plan is None else plan
    steps = StepProgress()
    operator = motion.operator(
        steps,
        *("go on where it ended", "run", *motion.repeated, "--resume"),
        artefact_moved=lambda station: False if motion.dry_run or motion.yes else ask_whether_moved(station),
    )
    with steps:
        if extend is None:
            done = mbcacq.run(
                to_run,
                dry_run=motion.dry_run,
                out=out,
                resume=resume,
                measure_again=again,
                live=live,
                seed=motion.seed,
                operator=operator,
                corrected=corrected,
            )
        else:
            done = mbcacq.extend(extend, to_run, dry_run=motion.dry_run, live=live, seed=motion.seed, operator=operator)
    forget_failure()
    return answer_of_run(done)


def plan_of(resume: Path | None) -> Path | mbcacq.LoadedPlan:
    """The plan of the run to go on with; if it has grown, the plan that its folder keeps. Raises UsageError where none is given."""
    if resume is None:
        raise click.UsageError("Missing argument 'PLAN': a plan file, or one of those that came with mbcacq, such as kuka.")
    if resume.is_dir() and run_plan.read_kept_plan(resume).grown_from is not None:
        return next_plan.plan_of_recording(resume)
    return run_plan.plan_of_run(resume)


def ask_whether_moved(station: str) -> bool:
    """Ask the person who moves the artefacts whether one was touched at a partly measured station: its poses would belong to two
    placements. Without a terminal it is taken to stand as it did."""
    if not sys.stdin.isatty():
        return False
    question = f"Station {station} was measured in part. Does its artefact stand exactly as then, untouched?"
    return not click.confirm(printable(question), err=True)
