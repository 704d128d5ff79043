"""``mbcacq plan program``: a plan's poses as a program of the robot's controller."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from mbcacq import plan as plans
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.recording.run_folder import progress
from mbcacq.workflow import controller_files, robot_program

LANGUAGES = ("krl", "rapid", "karel", "urscript", "vplus", "inform", "csv")
MAKERS = {"kuka": "krl", "abb": "rapid", "fanuc": "karel", "ur": "urscript", "staubli": "vplus", "yaskawa": "inform"}


@subcommand("program")
def program(
    plan: Path = argument(PlanPath()),
    dialect: str = option(
        f"{', '.join(LANGUAGES)}, or the maker: {', '.join(MAKERS)}.", [*LANGUAGES, *MAKERS], "--for", required=True, metavar="LANGUAGE"
    ),
    out: Path = option("Folder to write to.", required=True),
    wait: Literal["output", "pause", "key"] = option("How to wait at a pose.", ["output", "pause", "key"], default="output"),
    output: int = option("Digital output that triggers the scanner.", click.IntRange(0, 4096), default=1),
    exposure: float | None = option("Seconds to wait for one cloud [default: the plan's scan_time_s + 1].", click.FloatRange(0, 600)),
    resume: Path | None = option("Only the poses that this run folder lacks.", RunPath()),
    replace: bool = option("Write over files that are there already."),
) -> Answer:
    """Write a robot program that goes through the poses of PLAN by the checked routes and waits at each for its exposures.

    For an arm that mbcacq does not drive. The clouds that the scanner's own program saves meanwhile are read by `mbcacq collect`.

    \b
    Example:
      mbcacq plan program my-cell.yaml --for rapid --out program --wait key
    """
    from mbcacq.plan.programs import Trigger

    with StepProgress("checking every pose and every motion between them"):
        loaded = plans.load(plan)
        trigger = Trigger(wait, output, exposure_s=loaded.plan.scanner.scan_time_s + 1.0 if exposure is None else exposure)
        done = frozenset[int]() if resume is None else progress.poses_done(resume)
        dialect = MAKERS.get(dialect, dialect)
        files = robot_program.robot_program(loaded, dialect, trigger=trigger, done=done)
        written = controller_files.write(files, out, replace)
    clouds, rest = ("clouds", ()) if resume is None else ("more-clouds", ("--resume", resume))
    return Answer(
        {"format": "mbcacq-robot-program/1", "language": dialect, "files": [str(path) for path in written]},
        [*map(str, written), "nobody has run this program: first in the slow manual mode (T1, TEACH), a hand on the enabling switch"],
        (
            f"read {out / 'README.txt'}, save the scanner's clouds in a folder '{clouds}', and give the log of joint angles (--joints LOG)",
            command_line("collect", plan, "--clouds", clouds, *rest),
        ),
    )
