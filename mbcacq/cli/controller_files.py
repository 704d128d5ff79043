"""``mbcacq controller-files``: what belongs onto the robot's controller for a plan."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.terminal import echo


@click.command("controller-files")
@click.argument("plan", type=PlanPath())
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
@click.option("--replace", is_flag=True, help="Write over files that are there already.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(plan: Path, out: Path, replace: bool, as_json: bool) -> None:
    """Write the programs and configuration files for the robot's controller, with PLAN's addresses, limits and tool data.

    README.txt among them says where each file goes, and in which order things are started.
    """
    from mbcacq.plan import load
    from mbcacq.workflow import controller_files

    files = controller_files.make(load(plan))
    written = controller_files.write(files, out, replace)
    for warning in files.get("WARNINGS.txt", "").splitlines():
        echo(f"warning: {warning}", err=True)
    if as_json:
        echo(json.dumps({"format": "mbcacq-controller-files/1", "files": [str(path) for path in written]}))
        return
    for path in written:
        echo(str(path))
    echo("the tool frame in them is the plan's first guess, never verified: calibrate before it is relied upon")
    say_next(f"read {out / 'README.txt'}, then see whether the devices answer", command_line("doctor", plan))
