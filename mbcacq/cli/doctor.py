"""``mbcacq doctor``: what is missing, and what to do about it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ExitCode
from mbcacq.files.atomic_write import write_file

if TYPE_CHECKING:
    from mbcacq.doctor import CheckupLine

COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}
DEVICES = ("robot", "scanner", "positioner", "sensor", "devices")


@click.command("doctor")
@click.argument("plan", required=False, type=PlanPath())
@click.option("--protocol", is_flag=True, help="Instead: a protocol for the first contact of PLAN with real devices, to be ticked.")
@click.option(
    "--evidence", type=RunPath(every_kind=True), metavar="RUN", help="Instead: what the devices of a run said, as one JSON file to be sent."
)
@click.option("--anonymous", is_flag=True, help="With --evidence: without addresses, users and serial numbers.")
@click.option("--out", type=click.Path(path_type=Path), help="Where --protocol and --evidence write to [default: stdout].")
@click.option("--arm", is_flag=True, help="Connect a real robot too, which can switch its drives on; it is not moved.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(plan: Path | None, protocol: bool, evidence: Path | None, anonymous: bool, out: Path | None, arm: bool, as_json: bool) -> None:
    """Look at this computer: Python, libraries, drivers, disk, real-time rights, pictures; with PLAN also at its ports and network
    interface, and ask every device who it is.

    It prints one line for each thing, with a cure if something is wrong. The exit code is 3 if a device cannot be reached, and 2 if
    anything else is wrong.

    \b
    Examples:
      mbcacq doctor
      mbcacq doctor plans/kuka.yaml
      mbcacq doctor --protocol my-cell.yaml --out first-contact.md
      mbcacq doctor --evidence latest --anonymous --out evidence.json
    """
    if protocol or evidence is not None:
        write(page_of(plan) if evidence is None else json_of(evidence, anonymous), out)
        return
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
    else:
        say_next(*next_step(plan, bool(wrong)))
    if wrong:
        sys.exit(ExitCode.UNREACHABLE if any(line.topic.startswith(DEVICES) for line in wrong) else ExitCode.USAGE)


def next_step(plan: Path | None, wrong: bool) -> tuple[str, str]:
    """What to do after a look at the computer, and the command for it."""
    if wrong:
        return "do what the arrows say, then look again", command_line("doctor", plan or "")
    return "try it without hardware", command_line("run", plan or "kuka", "--dry-run")


def page_of(plan: Path | None) -> str:
    """The protocol of a first contact. Raises UsageError without a plan."""
    from mbcacq.doctor.first_contact import protocol
    from mbcacq.plan import load

    if plan is None:
        raise click.UsageError("--protocol needs a PLAN: the steps are those of its drivers")
    return protocol(load(plan))


def json_of(run: Path, anonymous: bool) -> str:
    """What the devices of a run said."""
    from mbcacq.doctor.evidence import evidence

    return json.dumps(evidence(run, anonymous), indent=1, ensure_ascii=False) + "\n"


def write(text: str, out: Path | None) -> None:
    """To a file, or to standard output. Raises RecordingError where the file cannot be written."""
    if out is None:
        echo(text.rstrip("\n"))
        return
    write_file(out, text)
    echo(f"written: {out}", err=True)


def print_line(line: CheckupLine) -> None:
    """One line, and its cure below it."""
    colour = False if os.environ.get("NO_COLOR") else None
    echo(f"  {line.topic}: {line.text}", label=(f"{line.level:7}", COLOURS[line.level]), color=colour)
    if line.cure:
        echo(f"         -> {line.cure}")
