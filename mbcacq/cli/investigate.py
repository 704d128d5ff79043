"""``mbcacq investigate``: the cell measures until it knows what it is, or says what is left open."""

from __future__ import annotations

from pathlib import Path

import click

import mbcacq
from mbcacq.cli.calibrate import lines_of
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line, forget_failure
from mbcacq.cli.operator import MotionOptions
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.model.json_text import fields_as_json


@subcommand("investigate")
def command(
    as_json: bool,
    plan: Path | None = argument(PlanPath(), required=False),
    out: Path | None = option("Run folder [default: runs/TIME_NAME]."),
    resume: Path | None = option("Go on with this investigation; its decisions stand.", metavar="FOLDER"),
    recording: Path | None = option("Begin with this finished run, and extend it.", None, "--from", metavar="RUN"),
    poses: int = option("Most poses, those measured already included.", click.IntRange(24, 400), default=96),
    moves: int | None = option("Most moves of artefacts to a station.", click.IntRange(1)),
    minutes: float | None = option("Longest duration, by the times that a plan takes for its poses and moves.", click.FloatRange(1)),
    limit_mm: float | None = option("Error of length that matters; an effect below it need not be found.", click.FloatRange(0.001)),
    live: bool = option("Serve the recording to a rerun viewer on 127.0.0.1 while it grows."),
    motion: MotionOptions = MotionOptions,  # type: ignore[assignment]
) -> Answer:
    """Measure with PLAN's cell, weigh all explanations, choose the next visit of a station, and stop when the cell is known.

    It begins with the 24 poses of PLAN that show most. It ends when no effect can hide or every effect is known beyond doubt, when
    the budget is spent, or when no pose that can be reached decides more. It then says what is left open.

    \b
    Examples:
      mbcacq investigate plans/concealed.yaml --dry-run
      mbcacq investigate my-cell.yaml --arm --poses 64 --moves 12
      mbcacq investigate --from runs/2026-11-21T10-00-00_my-cell --arm
    """
    end_in_order_on_signals()
    steps = StepProgress()
    operator = motion.operator(steps, "go on where it ended", "investigate", *motion.repeated, "--resume")
    budget = mbcacq.Budget(poses=poses, moves=moves, minutes=minutes, limit_mm=limit_mm)
    with steps:
        going = mbcacq.investigate(
            plan,
            budget,
            out=out,
            resume=resume,
            recording=recording,
            dry_run=motion.dry_run,
            seed=motion.seed,
            live=live,
            operator=operator,
        )
        for decision in going:
            steps.begin("")
            echo(decision.sentence, err=as_json)
        done = going.finish()
    forget_failure()
    document = {"decisions": [fields_as_json(d) for d in going.decisions], "result": done.to_dict()}
    lines = [*lines_of(done.to_dict()), f"how it was found: {going.page}"]
    then = "calibrate with what was found", command_line("diagnose", going.folder, "--calibrate")
    return Answer(document, lines, then, wide=True)
