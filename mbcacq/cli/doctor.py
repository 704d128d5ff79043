"""``mbcacq doctor``: what is missing, and what to do about it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ExitCode

if TYPE_CHECKING:
    from mbcacq.doctor import CheckupLine

COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}
DEVICES = ("robot", "scanner", "positioner", "sensor", "devices")


@click.command("doctor")
@click.argument("plan", required=False, type=PlanPath())
@click.option("--arm", is_flag=True, help="Connect a real robot too, which can switch its drives on; it is not moved.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(plan: Path | None, arm: bool, as_json: bool) -> None:
    """Look at this computer: Python, libraries, drivers, disk, real-time rights, pictures; with PLAN also at its ports and network
    interface, and ask every device who it is.

    A line a thing, with a cure where it is not well. Ends with exit code 3 if a device cannot be reached, 2 if anything else is wrong.

    \b
    Examples:
      mbcacq doctor
      mbcacq doctor plans/kuka.yaml
    """
    from mbcacq.doctor import checkup

    loaded = None
    if plan is not None:
        from mbcacq.plan import load

        loaded = load(plan)
    found = []
    with StepProgress() as progress:
        for line in checkup(loaded, arm, progress):
            found.append(line)
            if not as_json:
                progress.clear()
                print_line(line)
    wrong = [line for line in found if line.level == "error"]
    if as_json:
        echo(json.dumps({"format": "mbcacq-doctor/1", "errors": len(wrong), "lines": [line.to_dict() for line in found]}))
    if wrong:
        sys.exit(ExitCode.UNREACHABLE if any(line.topic.startswith(DEVICES) for line in wrong) else ExitCode.USAGE)


def print_line(line: CheckupLine) -> None:
    """One line, and its cure below it."""
    colour = False if os.environ.get("NO_COLOR") else None
    echo(f"  {line.topic}: {line.text}", label=(f"{line.level:7}", COLOURS[line.level]), color=colour)
    if line.cure:
        echo(f"         -> {line.cure}")
