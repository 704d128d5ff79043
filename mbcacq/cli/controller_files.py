"""``mbcacq controller-files``: what belongs onto the robot's controller for a plan."""

from __future__ import annotations

from pathlib import Path

from mbcacq import plan as plans
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.terminal import echo
from mbcacq.workflow import controller_files


@subcommand("controller-files")
def command(
    plan: Path = argument(PlanPath()),
    out: Path = option("Folder to write to.", required=True),
    replace: bool = option("Write over files that are there already."),
) -> Answer:
    """Write the programs and configuration files for the robot's controller, with PLAN's addresses, limits and tool data.

    README.txt among them says where each file goes, and in which order things are started.
    """
    files = controller_files.make(plans.load(plan))
    written = controller_files.write(files, out, replace)
    for warning in files.get("WARNINGS.txt", "").splitlines():
        echo(f"warning: {warning}", err=True)
    return Answer(
        {"format": "mbcacq-controller-files/1", "files": [str(path) for path in written]},
        [*map(str, written), "the tool frame in them is the plan's first guess, never verified: calibrate before it is relied upon"],
        (f"read {out / 'README.txt'}, then see whether the devices answer", command_line("doctor", plan)),
    )
