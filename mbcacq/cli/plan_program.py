"""``mbcacq plan program``: a plan's poses as a program of the robot's controller."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo

LANGUAGES = ("krl", "rapid", "karel", "urscript", "vplus", "inform", "csv")


@click.command("program")
@click.argument("plan", type=PlanPath())
@click.option("--for", "dialect", type=click.Choice(LANGUAGES), required=True, help="Language of the controller.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
@click.option("--name", default="mbcacq_poses", show_default=True, help="Name of the program, at most 12 characters.")
@click.option("--wait", type=click.Choice(["output", "pause", "key"]), default="output", show_default=True, help="How to wait at a pose.")
@click.option("--output", type=click.IntRange(0, 4096), default=1, show_default=True, help="Digital output that triggers the scanner.")
@click.option("--exposure", type=click.FloatRange(0, 600), help="Seconds to wait for one cloud [default: the plan's scan_time_s + 1].")
@click.option("--resume", type=RunPath(), help="Only the poses that this run folder lacks.")
@click.option("--replace", is_flag=True, help="Write over files that are there already.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def program(
    plan: Path,
    dialect: str,
    out: Path,
    name: str,
    wait: Literal["output", "pause", "key"],
    output: int,
    exposure: float | None,
    resume: Path | None,
    replace: bool,
    as_json: bool,
) -> None:
    """Write a robot program that goes through the poses of PLAN by the checked routes and waits at each for its exposures.

    For an arm that mbcacq does not drive. The clouds that the scanner's own program saves meanwhile are read by `mbcacq collect`.

    \b
    Example:
      mbcacq plan program my-cell.yaml --for rapid --out program --wait key
    """
    from mbcacq.plan import load
    from mbcacq.plan.programs import Trigger
    from mbcacq.recording.run_folder.progress import poses_done
    from mbcacq.workflow.robot_program import robot_program, write_files

    with StepProgress() as steps:
        steps.begin("checking every pose and every motion between them")
        loaded = load(plan)
        trigger = Trigger(wait, output, exposure_s=loaded.plan.scanner.scan_time_s + 1.0 if exposure is None else exposure)
        done = frozenset[int]() if resume is None else poses_done(resume)
        files = robot_program(loaded, dialect, name=name, trigger=trigger, done=done)
        written = write_files(files, out, replace)
    if as_json:
        echo(json.dumps({"format": "mbcacq-robot-program/1", "language": dialect, "files": [str(path) for path in written]}))
        return
    for path in written:
        echo(str(path))
    echo("nobody has run this program: first in T1 or at reduced speed, a hand on the enabling switch")
    say_next(
        f"read {out / 'README.txt'}, save the clouds of the scanner in a folder 'clouds'",
        command_line("collect", plan, "--clouds", "clouds"),
    )
