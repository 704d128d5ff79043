"""``mbcacq investigate``: the cell measures until it knows what it is, or says what is left open."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import command_line, forget_failure, on_failure, say_next
from mbcacq.cli.operator import MotionOptions, moves_an_arm
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.terminal import echo


@click.command("investigate")
@click.argument("plan", required=False, type=PlanPath())
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [default: runs/TIME_NAME].")
@click.option("--resume", type=click.Path(path_type=Path), metavar="FOLDER", help="Go on with this investigation; its decisions stand.")
@click.option("--from", "recording", type=click.Path(path_type=Path), metavar="RUN", help="Begin with this finished run, and extend it.")
@click.option("--poses", type=click.IntRange(24, 400), default=96, show_default=True, help="Most poses, those measured already included.")
@click.option("--moves", type=click.IntRange(1), help="Most moves of artefacts to a station.")
@click.option("--minutes", type=click.FloatRange(1), help="Longest duration, by the times that a plan takes for its poses and moves.")
@click.option("--limit-mm", type=click.FloatRange(0.001), help="Error of length that matters; an effect below it need not be found.")
@click.option("--live", is_flag=True, help="Serve the recording to a rerun viewer on 127.0.0.1 while it grows.")
@moves_an_arm(
    confirmed="speed, workspace and first target of every visit are typed", drawn="the fake cell, and of the views to choose from"
)
@click.option("--json", "as_json", is_flag=True, help="Print the decisions and the result as one JSON object on stdout.")
def command(
    plan: Path | None,
    out: Path | None,
    resume: Path | None,
    recording: Path | None,
    poses: int,
    moves: int | None,
    minutes: float | None,
    limit_mm: float | None,
    live: bool,
    motion: MotionOptions,
    as_json: bool,
) -> None:
    """Measure with PLAN's cell, weigh all explanations, choose the next visit of a station, and stop when the cell is known.

    It begins with the 24 poses of PLAN that show most. It ends when no effect can hide or every effect is known beyond doubt, when
    the budget is spent, or when no pose that can be reached decides more. It then says what is left open.

    \b
    Examples:
      mbcacq investigate plans/concealed.yaml --dry-run
      mbcacq investigate my-cell.yaml --arm --poses 64 --moves 12
      mbcacq investigate --from runs/2026-11-21T10-00-00_my-cell --arm
    """
    import mbcacq
    from mbcacq.cli.signals import end_in_order_on_signals
    from mbcacq.cli.step_progress import StepProgress

    end_in_order_on_signals()
    steps = StepProgress()
    operator = motion.operator(
        steps,
        began=lambda folder: on_failure(
            "go on where it ended", command_line("investigate", *motion.repeated, "--resume", folder), folder / "run.rrd"
        ),
    )
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
    if as_json:
        from mbcacq.model.json_text import fields_as_json

        echo(json.dumps({"decisions": [fields_as_json(d) for d in going.decisions], "result": done.to_dict()}))
        return
    from mbcacq.cli.calibrate import print_result

    print_result(done.to_dict())
    echo(f"how it was found: {going.page}")
    say_next("calibrate with what was found", command_line("diagnose", going.folder, "--calibrate"))
